"""TIFF files written by hand, as programs write them that OpenCV does not imitate."""

import struct


def tiff_behind_one_directory(stack, description, numbers):
    """File of images (n, rows, columns) behind one directory, which lists the first only; numbers is SampleFormat."""
    order, mark = (">", b"MM\0*") if stack.dtype.str[0] == ">" else ("<", b"II*\0")
    text = description.encode() + b"\0"
    text += b"\0" * (4 + len(text) % 2)
    count, rows, columns = stack.shape
    start = 8 + 2 + 12 * 10 + 4
    tags = [
        (256, 4, 1, columns), (257, 4, 1, rows), (258, 3, 1, 8 * stack.dtype.itemsize), (259, 3, 1, 1), (262, 3, 1, 1),
        (270, 2, len(text), start), (273, 4, 1, start + len(text)), (278, 4, 1, rows),
        (279, 4, 1, stack.nbytes // count), (339, 3, 1, numbers),
    ]  # fmt: skip
    entries = [
        struct.pack(order + "HHI", *tag[:3]) + struct.pack(order + ("Hxx" if tag[1] == 3 else "I"), tag[3])
        for tag in tags
    ]
    head = mark + struct.pack(order + "IH", 8, len(tags)) + b"".join(entries) + struct.pack(order + "I", 0)
    return head + text + stack.tobytes()
