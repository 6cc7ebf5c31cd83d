"""Edges of discs along rays, to a fraction of a pixel, and the contrast well inside of discs."""

import numpy as np

from dynpf.kernels.compiler import device, kernel

__all__ = ["inner_contrasts", "rims"]

_LEAST_LEVEL = 1e-3  # of a disc's contrast, that it can be divided by
_LEAST_SLOPE = 0.2  # of the relative contrast a pixel


@device
def _bilinear(image, x, y):
    """Return the image's value at a point; outside, the border's."""
    height, width = image.shape
    # Of two numbers one of which is NaN, max and min return the first.
    x = min(max(0.0, x), np.float64(width - 1))
    y = min(max(0.0, y), np.float64(height - 1))
    left, top = min(np.int64(x), width - 2), min(np.int64(y), height - 2)
    part_x, part_y = x - left, y - top
    upper = image[top, left] * (1.0 - part_x) + image[top, left + 1] * part_x
    lower = image[top + 1, left] * (1.0 - part_x) + image[top + 1, left + 1] * part_x
    return upper * (1.0 - part_y) + lower * part_y


@kernel
def inner_contrasts(image, circles, grid, out):
    """Fill ``out`` (D,) with the median of ``image`` (H, W) at the places ``grid`` (G, 2), in radii, of each circle."""
    values = np.empty(len(grid))
    for d in range(len(circles)):
        for g in range(len(grid)):
            x = circles[d, 0] + circles[d, 2] * grid[g, 0]
            y = circles[d, 1] + circles[d, 2] * grid[g, 1]
            values[g] = _bilinear(image, x, y)
        out[d] = np.median(values)


@kernel
def rims(image, circles, levels, rays, search, apart, points, visible, found, falls):
    """Fill the edges' ``points`` (D, R, 2) of ``circles`` (D, 3) along ``rays`` (R, 2), and what they are, (D, R).

    ``levels`` (D,) are the discs' contrasts. ``search``: how far from the expected rim an edge is looked for, the step
    between samples, how many of them tell inside and outside, the least relative fall, and the clearance from circles
    that are ``apart`` (D, D).
    """
    reach, step, side, least_fall, clearance = search
    height, width = image.shape
    samples = np.int64(2.0 * reach / step) + 1
    profile, shifts = np.empty(samples), np.empty(len(rays))
    for d in range(len(circles)):
        x, y, radius = circles[d, 0], circles[d, 1], circles[d, 2]
        level = _LEAST_LEVEL if abs(levels[d]) < _LEAST_LEVEL else levels[d]
        slopes, count = 0.0, 0
        for r in range(len(rays)):
            for s in range(samples):
                along = radius + (s * step - reach)
                profile[s] = _bilinear(image, x + along * rays[r, 0], y + along * rays[r, 1]) / level
            shifts[r], drop, fall = _crossing(profile, reach, step, side, least_fall)
            found[d, r] = drop > 0.0
            falls[d, r] = fall * abs(level)
            if drop > 0.0:
                slopes += drop
                count += 1
        inset = _inset(slopes / max(count, 1) / step, radius)
        farthest = radius + reach
        for r in range(len(rays)):
            along = radius + (shifts[r] + inset)
            rim_x, rim_y = x + along * rays[r, 0], y + along * rays[r, 1]
            points[d, r, 0], points[d, r, 1] = rim_x, rim_y
            end_x, end_y = x + farthest * rays[r, 0], y + farthest * rays[r, 1]
            seen = 0.0 <= end_x <= width - 1 and 0.0 <= end_y <= height - 1
            for e in range(len(circles)):
                dx, dy = rim_x - circles[e, 0], rim_y - circles[e, 1]
                seen = seen and not (apart[d, e] and np.sqrt(dx * dx + dy * dy) - circles[e, 2] < clearance)
            visible[d, r] = seen
            found[d, r] = found[d, r] and seen
            falls[d, r] = falls[d, r] if found[d, r] else 0.0


@device
def _crossing(profile, reach, step, side, least_fall):
    """Return where the profile falls through its middle, nearest to the expected rim, and how far it drops there.

    The drop is zero where there is no edge. The third is how far the profile falls.
    """
    inside, outside = 0.0, profile[profile.size - 1]
    for s in range(side):
        inside += profile[s]
        outside = min(outside, profile[profile.size - 1 - s])
    inside = inside / side
    middle, fall = 0.5 * (inside + outside), inside - outside
    shift, dropped = 0.0, 0.0
    if fall >= least_fall:
        nearest = np.inf
        for s in range(profile.size - 1):
            before, after = (profile[s] - middle) / fall, (profile[s + 1] - middle) / fall
            if before >= 0.0 and after < 0.0:
                drop = before - after
                crossing = (s * step - reach) + step * before / drop
                if abs(crossing) < nearest:
                    nearest, shift, dropped = abs(crossing), crossing, drop
    return shift, dropped, max(fall, least_fall)


@device
def _inset(slope, radius):
    """Return how far blur pulls the half-height edge of a disc inward: sigma^2 / (2 radius) for a Gaussian.

    sigma follows from the slope at half height, 1 / (sigma sqrt(2 pi)).
    """
    sigma = 1.0 / (np.sqrt(2.0 * np.pi) * max(slope, _LEAST_SLOPE))
    return sigma * sigma / (2.0 * radius)
