"""Pictures whose header states any size."""

import struct
import zlib


def png_of_size(columns, rows):
    """Return the header of a PNG file of any size, which holds a single line."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(columns + 1))) + chunk(b"IEND", b"")
