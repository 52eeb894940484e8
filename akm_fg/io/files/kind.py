"""What a file that cannot be read looks like, by its first bytes."""

from __future__ import annotations

_FIRST_BYTES = (
    (b"PK\x03\x04", "a zip archive, such as .npz or .xlsx"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"#ROSBAG", "a ROS 1 bag"),
    (b"SQLite format 3", "an SQLite file, such as a ROS 2 bag"),
    (b"\x89MCAP", "an MCAP recording"),
    (b"\x89HDF", "an HDF5 file"),
    (b"\x93NUMPY", "a NumPy array (.npy)"),
    (b"\x80\x04", "a pickle"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"%PDF", "a PDF"),
    (b"ply", "a PLY cloud"),
    (b"%YAML", "YAML"),
    (b"header:", "what `ros topic echo` prints"),
    (b"<", "XML"),
    (b"{", "JSON"),
    (b"[", "JSON"),
)


def looks_like(data: bytes) -> str:
    """`, looks like ...` for a message, or nothing where the first bytes say nothing."""
    start = data[:64].lstrip(b"\xef\xbb\xbf \t\r\n")
    for first, what in _FIRST_BYTES:
        if start.startswith(first):
            return f", looks like {what}"
    return ""
