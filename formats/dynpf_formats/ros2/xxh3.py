"""XXH3-128 of short texts, by which rmw_zenoh names publishers after their tokens.

Source: the xxHash specification, XXH3 (seed 0, default secret); texts of 17 to 1024 bytes, as all tokens are.
"""

import struct

__all__ = ["xxh3_128"]

_SECRET = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671fcb79e64eccc0e578825ad07dccff7221"
    "b8084674f743248ee03590e6813a264c3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
    "a8fa763fe39c343ff9dcbbc7c70b4f1d8a51e04bcdb45931c89f7ec9d9787364eac5ac8334d3ebc3c581a0fffa1363eb"
    "170ddd51b7f0da49d316552629d4689e2b16be587d47a1fc8ff8b8d17ad031ce45cb3a8f95160428afd7fbcabb4b407e"
)
_PRIMES_32 = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
_PRIMES = (0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x85EBCA77C2B2AE63, 0x27D4EB2F165667C5)
_START = (_PRIMES_32[2], *_PRIMES[:4], _PRIMES_32[1], _PRIMES[4], _PRIMES_32[0])
_MASK = 2**64 - 1
_STRIPE = 64  # bytes


def xxh3_128(data: bytes) -> int:
    """Return the hash of 17 to 1024 bytes; raises ValueError for others."""
    size = len(data)
    if not 17 <= size <= 1024:
        raise ValueError(f"{size} bytes; expected 17 to 1024")
    if size > 240:
        return _of_stripes(data)
    low, high = size * _PRIMES[0] & _MASK, 0
    if size <= 128:
        for piece in range((size - 1) // 32, -1, -1):
            low, high = _mixed(low, high, data[16 * piece :], data[size - 16 * (piece + 1) :], 32 * piece)
    else:
        for place in range(0, 128, 32):
            low, high = _mixed(low, high, data[place:], data[place + 16 :], place)
        low, high = _avalanche(low), _avalanche(high)
        for place in range(128, size - 31, 32):
            low, high = _mixed(low, high, data[place:], data[place + 16 :], place - 125)
        low, high = _mixed(low, high, data[-16:], data[-32:], 103)
    crossed = low * _PRIMES[0] + high * _PRIMES[3] + size * _PRIMES[1]
    return _avalanche((low + high) & _MASK) | (-_avalanche(crossed & _MASK) & _MASK) << 64


def _mixed(low: int, high: int, one: bytes, other: bytes, secret: int) -> tuple[int, int]:
    """Return the sums with two pieces of 16 bytes."""
    first, second = struct.unpack_from("<QQ", one), struct.unpack_from("<QQ", other)
    low = (low + _folded(first, secret) & _MASK) ^ (sum(second) & _MASK)
    high = (high + _folded(second, secret + 16) & _MASK) ^ (sum(first) & _MASK)
    return low, high


def _folded(pair: tuple[int, ...], secret: int) -> int:
    """Return the halves of a product of 128 bits, one on the other."""
    first, second = struct.unpack_from("<QQ", _SECRET, secret)
    product: int = (pair[0] ^ first) * (pair[1] ^ second)
    return (product & _MASK) ^ (product >> 64)


def _avalanche(number: int) -> int:
    number = (number ^ number >> 37) * 0x165667919E3779F9 & _MASK
    return number ^ number >> 32


def _of_stripes(data: bytes) -> int:
    size, sums = len(data), list(_START)
    whole = (size - 1) // _STRIPE
    stripes = [(data[_STRIPE * number :], 8 * number) for number in range(whole)]
    for stripe, secret in [*stripes, (data[-_STRIPE:], 121)]:
        values, keys = struct.unpack_from("<8Q", stripe), struct.unpack_from("<8Q", _SECRET, secret)
        for lane, (value, key) in enumerate(zip(values, keys, strict=True)):
            keyed = value ^ key
            sums[lane ^ 1] = sums[lane ^ 1] + value & _MASK
            sums[lane] = sums[lane] + (keyed & 0xFFFFFFFF) * (keyed >> 32) & _MASK
    low = _merged(sums, 11, size * _PRIMES[0])
    return low | _merged(sums, 117, ~(size * _PRIMES[1])) << 64


def _merged(sums: list[int], secret: int, start: int) -> int:
    folds = (_folded((sums[lane], sums[lane + 1]), secret + 8 * lane) for lane in range(0, 8, 2))
    return _avalanche(start + sum(folds) & _MASK)
