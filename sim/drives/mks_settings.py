"""What an MKS SERVO42D or SERVO57D keeps in flash, as bytes (manual V1.0.6, 5.2 to 5.5)."""

from __future__ import annotations

FACTORY: dict[int, bytes] = {
    0x82: b"\x02",
    0x83: b"\x06\x40",
    0x84: b"\x10",
    0x85: b"\x00",
    0x86: b"\x00",
    0x87: b"\x00",
    0x88: b"\x00",
    0x89: b"\x01",
    0x8A: b"\x02",
    0x8B: b"\x00\x01",
    0x8C: b"\x01\x01",
    0x8D: b"\x00\x00",
    0x8F: b"\x00",
    0x90: b"\x00\x00\x00\x3c\x00\x00",
    0x94: b"\x00\x00\x20\x00\x03\x20",
    0x9A: b"\x00\x00\x00\x00",
    0x9B: b"\x04",
    0x9D: b"\x00\x00\x00\x00\x00",
    0x9E: b"\x00",
}
"""As they leave the factory, by the code that sets them; their length is what a request must have."""

HIGHEST: dict[int, bytes] = {
    0x82: b"\x05",
    0x85: b"\x02",
    0x86: b"\x01",
    0x87: b"\x01",
    0x88: b"\x01",
    0x89: b"\x01",
    0x8A: b"\x03",
    0x8B: b"\x07\xff",
    0x8C: b"\x01\x01",
    0x8D: b"\x07\xff",
    0x8F: b"\x01",
    0x90: b"\x01\x01\xff\xff\x01\x01",
    0x9B: b"\x08",
    0x9E: b"\x01",
}
"""Highest value of each byte, where a range is known."""
