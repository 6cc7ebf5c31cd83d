"""Drawing in camera frames: discs and lines with blurred edges, and the noise of the sensor."""

import numpy as np

from dynpf.kernels.compiler import device, kernel

__all__ = ["add_noise", "draw_disc", "draw_line"]

_f = np.float32
_ZERO, _HALF, _WHITE = _f(0.0), _f(0.5), _f(255.0)


@kernel
def draw_disc(frame, place_x, place_y, light, box, disc, px_per_m, edge, colour):
    """Draw a disc, float32 (3,): x, y and radius in metres, into ``frame`` (H, W, 3) within ``box``.

    ``place_x`` and ``place_y`` (H, W), float32, are where each pixel looks, ``light`` (H, W) how lit it is, ``edge`` as
    for ``draw_line``. The box is top, bottom, left and right.
    """
    top, bottom, left, right = box
    index = np.empty(max(right - left, 0), dtype=np.int32)
    for row in range(top, bottom):
        for i in range(index.size):
            x, y = place_x[row, left + i] - disc[0], place_y[row, left + i] - disc[1]
            index[i] = _step((np.sqrt(x * x + y * y) - disc[2]) * px_per_m, edge)
        _paint(frame, row, left, index, edge[2], colour, light)


@kernel
def draw_line(frame, place_x, place_y, light, box, line, px_per_m, edge, colour):
    """Draw a line, float32 (7,), as ``draw_disc`` does: x, y, cosine, sine, from where, to where, half its width.

    The first six in metres and the last in pixels. ``edge`` (reach, steps a pixel, profile (P,)): the share of a pixel
    that is covered, by its distance outside the border from -reach on, float32.
    """
    top, bottom, left, right = box
    index = np.empty(max(right - left, 0), dtype=np.int32)
    for row in range(top, bottom):
        for i in range(index.size):
            x, y = place_x[row, left + i] - line[0], place_y[row, left + i] - line[1]
            along = min(max(x * line[2] + y * line[3], line[4]), line[5])
            off_x, off_y = x - along * line[2], y - along * line[3]
            index[i] = _step(np.sqrt(off_x * off_x + off_y * off_y) * px_per_m - line[6], edge)
        _paint(frame, row, left, index, edge[2], colour, light)


@kernel
def add_noise(frame, noise, top, left, sign):
    """Add to ``frame`` (H, W, 3) the noise, int16, from (top, left) on, times ``sign``, which is 1 or -1."""
    height, width, colours = frame.shape
    sign = np.int16(sign)
    for row in range(height):
        pixels = frame[row].reshape(-1)
        added = noise[top + row, left : left + width].reshape(-1)
        for i in range(width * colours):
            level = np.int16(pixels[i]) + np.int16(sign * added[i])
            pixels[i] = np.uint8(min(max(np.int16(level), np.int16(0)), np.int16(255)))


@device
def _step(outside_px, edge):
    """Return which value of the profile a distance outside of a shape's border in pixels has."""
    reach, steps, profile = edge
    # Of two numbers one of which is NaN, max and min return the first.
    return np.int32(min(max(_ZERO, (outside_px + reach) * steps), _f(profile.size - 1)) + _HALF)


@device
def _paint(frame, row, left, index, profile, colour, light):
    """Mix a colour in the light, which may be too bright, into pixels of a row, covered as ``profile[index]`` says."""
    blue, green, red = colour[0], colour[1], colour[2]
    for i in range(index.size):
        cover = profile[index[i]]
        if cover > _ZERO:
            column = left + i
            lit = light[row, column]
            frame[row, column, 0] = _mixed(frame[row, column, 0], cover, lit * blue)
            frame[row, column, 1] = _mixed(frame[row, column, 1], cover, lit * green)
            frame[row, column, 2] = _mixed(frame[row, column, 2], cover, lit * red)


@device
def _mixed(level, cover, wanted):
    target = _f(level)
    return np.uint8(target + cover * (min(_WHITE, wanted) - target) + _HALF)
