"""Compressed chunks of ROS bags and MCAP files, and files of zstd: their size before they are read.

The readers of these formats expand a chunk whole, whatever it says of its size. So every chunk is
expanded here once in pieces that are thrown away, and counted.
"""

import bz2
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from diffsea.errors import UserError
from diffsea.outside.sizes import Meter


_BAG_CHUNK, _MCAP_CHUNK = 5, 6  # op codes
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_FIXED = 24  # bytes of a chunk before its checksum: two times and its size
_LONGEST_HEADER = 1 << 20  # bytes of a record of a ROS 1 bag
_PIECE = 1 << 20


def check_chunks(path: Path) -> None:
    """Raise `UserError` where the compressed parts of a bag would be larger than the limit.

    Of a folder, every file in it counts for itself. Parts that are damaged are left to the reader.
    """
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in files:
        meter = Meter(file)
        if not file.is_file():
            continue
        with file.open("rb") as source:
            start = source.read(len(_MCAP_MAGIC))
            parts: Iterator[tuple[str, bytes]] = iter(())
            if start == _MCAP_MAGIC:
                parts = _chunks_of_mcap(source)
            elif start.startswith(b"#ROSBAG"):
                source.seek(0)
                source.readline(64)
                parts = _chunks_of_bag(source)
            elif file.suffix == ".zstd":
                source.seek(0)
                parts = (("zstd", piece) for piece in [source.read()])
            for compression, content in parts:
                _count(compression, content, meter)


def _chunks_of_mcap(source: BinaryIO) -> Iterator[tuple[str, bytes]]:
    """Compression and content of every chunk at the top of the file."""
    end = os.fstat(source.fileno()).st_size
    while len(head := source.read(9)) == 9:
        kind, size = struct.unpack("<BQ", head)
        after = min(source.tell() + size, end)
        if kind == _MCAP_CHUNK:
            source.seek(_MCAP_FIXED, 1)
            checksum_and_length = source.read(8)
            if len(checksum_and_length) < 8:
                return
            length = struct.unpack("<II", checksum_and_length)[1]
            name = source.read(min(length, 16)).decode(errors="replace")
            source.seek(8, 1)
            yield name, source.read(max(0, after - source.tell()))
        source.seek(after)


def _chunks_of_bag(source: BinaryIO) -> Iterator[tuple[str, bytes]]:
    """Compression and content of every chunk of a ROS 1 bag."""
    while len(head := source.read(4)) == 4:
        size = struct.unpack("<I", head)[0]
        header = source.read(min(size, _LONGEST_HEADER))
        length = source.read(4)
        if len(header) < size or len(length) < 4:
            return
        after = source.tell() + struct.unpack("<I", length)[0]
        fields = _fields_of_header(header)
        if fields.get(b"op") == bytes([_BAG_CHUNK]):
            name = fields.get(b"compression", b"none").decode(errors="replace")
            yield name, source.read(after - source.tell())
        source.seek(after)


def _fields_of_header(header: bytes) -> dict[bytes, bytes]:
    found, at = {}, 0
    while at + 4 <= len(header):
        size = struct.unpack_from("<I", header, at)[0]
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        found[name] = value
        at += 4 + size
    return found


def _count(compression: str, content: bytes, meter: Meter) -> None:
    """Adds the bytes that a part expands to. Raises `UserError` above the limit."""
    if compression not in ("lz4", "zstd", "bz2"):
        meter.add(len(content))
        return
    try:
        inflate: Any = _inflater(compression)
        piece = inflate.decompress(content, _PIECE)
        while True:
            meter.add(len(piece))
            if inflate.eof or not piece:
                return
            piece = inflate.decompress(b"", _PIECE)
    except UserError:
        raise
    except Exception:  # the reader says what is wrong with the part
        return


def _inflater(compression: str) -> Any:
    """An object that expands in pieces, with `decompress(content, most)` and `eof`."""
    if compression == "bz2":
        return bz2.BZ2Decompressor()
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor()
    try:
        from compression import zstd  # pyright: ignore[reportMissingImports]
    except ImportError:
        from backports import zstd
    return zstd.ZstdDecompressor()
