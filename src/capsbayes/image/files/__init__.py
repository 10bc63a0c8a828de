"""Files of pictures, films, .rtdc events and contours."""
