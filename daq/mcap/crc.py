"""The CRC of two stretches of bytes from the CRCs of each: what was summed up once need not be read again.

A CRC-32 is the remainder of the bytes as a polynomial over {0, 1} modulo the polynomial of IEEE 802.3. Bytes put in
front of n others are thereby multiplied by x^8n, so crc(a b) = crc(a)·x^8n + crc(b). Bits are reflected as in zlib:
the highest is x^0.
"""

from typing import Any

from numba import njit

_POLYNOMIAL = 0xEDB88320
_X8 = 1 << 23


def joined_crc(first: int, second: int, second_bytes: int) -> int:
    """CRC-32 of bytes a followed by bytes b.

    Args:
        first, second: zlib.crc32 of a and of b.
        second_bytes: length of b.
    """
    return int(_shifted(first, second_bytes)) ^ second


@njit(cache=True, nogil=True)
def _shifted(crc: Any, count: Any) -> Any:  # pragma: no cover - compiled
    """crc · x^(8·count): the power by repeated squaring."""
    power = _X8
    while count:
        if count & 1:
            crc = _product(crc, power)
        power = _product(power, power)
        count >>= 1
    return crc


@njit(nogil=True)
def _product(a: Any, b: Any) -> Any:  # pragma: no cover - compiled
    """a · b modulo the polynomial."""
    product = 0
    for bit in range(31, -1, -1):
        if a >> bit & 1:
            product ^= b
        b = b >> 1 ^ (_POLYNOMIAL if b & 1 else 0)
    return product
