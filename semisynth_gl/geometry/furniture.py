"""Furniture and other things in rooms: tables, chairs, shelves, lamps, frames."""

import numpy as np

from semisynth_gl.geometry.mesh import Parts
from semisynth_gl.geometry.parts import arc, ball, circle, lift, placed, rectangle, rod, spline, wire
from semisynth_gl.geometry.rotations import about_x, about_z, even_turns
from semisynth_gl.geometry.surfaces import box, extruded, extruded_cells, lathe, sweep


def table(rng: np.random.Generator) -> Parts:
    """A table: a round top on a column, or a rectangular top on four legs, which may splay."""
    height = rng.uniform(0.5, 1.1)
    thick = rng.uniform(0.03, 0.07)
    if rng.random() < 0.35:
        radius = rng.uniform(0.5, 0.8)
        foot = [(0, 0), (0.6 * radius, 0), (0.55 * radius, 0.04), (0.07, 0.1), (0.05, height / 2), (0.09, height)]
        plate = [(0, height), (radius, height), (radius, height + thick), (0, height + thick)]
        yield from (lathe([*foot, (0, height)]), lathe(plate, 48))
        return
    length, width = rng.uniform(1, 1.8), rng.uniform(0.6, 1)
    splay = rng.choice([0.0, rng.uniform(0.03, 0.12)])
    leg = rng.uniform(0.02, 0.05)
    yield box((length, width, thick), (0, 0, height))
    for corner in np.array([(-1, -1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0)]):
        top = corner * (length / 2 - 2 * leg, width / 2 - 2 * leg, 0) + (0, 0, height)
        yield rod(top * (1, 1, 0) + splay * corner, top, 0.7 * leg, leg, sides=10)
    if rng.random() < 0.5:
        rail = height - rng.uniform(0.08, 0.2)
        yield from [box((length - 4 * leg, 0.02, 0.06), (0, y * (width / 2 - 2 * leg), rail)) for y in (-1, 1)]


def chair(rng: np.random.Generator) -> Parts:
    """A chair with a back of slats, bars or one board; some have arms."""
    width, depth, seat = rng.uniform(0.4, 0.55), rng.uniform(0.4, 0.55), rng.uniform(0.4, 0.5)
    back, leg, lean = rng.uniform(0.35, 0.65), rng.uniform(0.012, 0.028), rng.uniform(0.02, 0.15)
    x, y = width / 2 - leg, depth / 2 - leg
    yield box((width, depth, rng.uniform(0.02, 0.07)), (0, 0, seat))
    yield from [rod((side * x, -y, 0), (side * x, -y, seat), leg) for side in (-1, 1)]
    for side in (-1, 1):
        post = [(side * x, y + lean / 3, 0), (side * x, y, seat), (side * x, y + lean, seat + back)]
        yield wire(spline(post, 4), leg)
    low, high = (np.array([0, y + share * lean, seat + share * back]) for share in (0.35, 0.9))
    tilt = about_x(-float(np.arctan2(lean, back)))
    style = rng.integers(3)
    if style == 0:
        yield placed(box((2 * x, 0.02, 0.55 * back)), (low + high) / 2, rotation=tilt)
    else:
        count = int(rng.integers(2, 6))
        yield from [placed(box((2 * x, 0.025, 0.05)), end, rotation=tilt) for end in (low, high)]
        board = box((2 * x, 0.015, 0.25 * back / count))
        for share in (np.arange(count) + 0.5) / count:
            aside = ((2 * share - 1) * x, 0, 0)
            slat = placed(board, low + share * (high - low), rotation=tilt)
            yield rod(low + aside, high + aside, 0.01) if style == 1 else slat
    if rng.random() < 0.4:
        rest = seat + rng.uniform(0.18, 0.26)
        for side in (-1, 1):
            yield rod((side * x, -y + 0.05, seat), (side * x, -y + 0.05, rest), 0.8 * leg)
            yield box((0.05, depth, 0.025), (side * x, 0.03, rest))


def bookcase(rng: np.random.Generator) -> Parts:
    """A bookcase with a back, and upright books with gaps between them."""
    width, depth, board = rng.uniform(0.6, 1.2), rng.uniform(0.2, 0.3), 0.025
    shelves, gap = int(rng.integers(2, 6)), rng.uniform(0.26, 0.34)
    height = shelves * gap
    yield from [box((board, depth, height), (side * (width + board) / 2, 0, height / 2)) for side in (-1, 1)]
    yield box((width, 0.01, height), (0, depth / 2, height / 2))
    levels = np.arange(shelves + 1) * (height - board) / shelves
    yield from [box((width, depth - 0.02, board), (0, 0, level + board / 2)) for level in levels]
    for floor in levels[:-1] + board:
        x = -width / 2 + 0.01
        while x < width / 2 - 0.08:
            book = np.array([rng.uniform(0.015, 0.05), depth * rng.uniform(0.55, 0.85), gap * rng.uniform(0.55, 0.85)])
            if rng.random() < 0.12:
                x += rng.uniform(0.03, 0.15)
                continue
            yield box(book, (x + book[0] / 2, -0.02, floor + book[2] / 2))
            x += book[0] + rng.uniform(0.001, 0.004)


def shelf(rng: np.random.Generator) -> Parts:
    """Boards on thin posts, with jars, balls and boxes on them."""
    width, depth, height = rng.uniform(0.6, 1.1), rng.uniform(0.25, 0.4), rng.uniform(0.8, 1.5)
    levels, post = int(rng.integers(2, 5)), rng.uniform(0.008, 0.02)
    feet = [(x * width / 2, y * depth / 2) for x in (-1, 1) for y in (-1, 1)]
    yield from [rod((*foot, 0), (*foot, height), post) for foot in feet]
    for level in np.linspace(0.12, 0.95, levels) * height:
        yield box((width + 2 * post, depth + 2 * post, 0.018), (0, 0, level))
        for x in np.arange(-width / 2 + 0.1, width / 2 - 0.05, 0.17):
            size, floor = rng.uniform(0.04, 0.07), level + 0.009
            tall = size * rng.uniform(1.2, 2.4)
            pick = rng.integers(4)
            if pick == 0:
                yield box((1.6 * size, 1.6 * size, tall), (x, rng.uniform(-0.03, 0.03), floor + tall / 2))
            elif pick == 1:
                jar = [(0, 0), (size, 0), (size, 0.75 * tall), (0.6 * size, 0.85 * tall), (0.6 * size, tall), (0, tall)]
                yield placed(lathe(jar, 16), (x, rng.uniform(-0.04, 0.04), floor))
            elif pick == 2:
                yield placed(ball(size, 16, 9), (x, 0, floor + size))


def lamp(rng: np.random.Generator) -> Parts:
    """A lamp with a hollow shade on a straight or bent stem."""
    height, shade, tall = rng.uniform(0.7, 1.5), rng.uniform(0.18, 0.32), rng.uniform(0.18, 0.35)
    neck, wall, stem = shade * rng.uniform(0.35, 0.85), 0.008, rng.uniform(0.01, 0.02)
    base = rng.uniform(0.13, 0.22)
    yield lathe([(0, 0), (base, 0), (base, 0.02), (stem, 0.05), (0, 0.05)])
    skin = [(shade, 0), (neck, tall), (neck - wall, tall), (shade - wall, 0)]
    if rng.random() < 0.5:
        top = np.array([0, 0, height])
        yield rod((0, 0, 0.03), top, stem, sides=10)
    else:
        reach = rng.uniform(0.25, 0.5)
        bow = [(0, 0.03), *(arc(1, np.pi, 0, 25) * (reach / 2, 0.3 * height) + (reach / 2, 0.75 * height))]
        top = np.array([reach, 0, bow[-1][1]])
        yield wire(lift(np.array(bow), "xz"), stem, 10)
    yield placed(lathe(skin, 36, closed=True), top - (0, 0, tall / 2))
    yield placed(ball(0.045, 16, 9), top)
    yield from [rod(top, top + turn @ (neck - wall / 2, 0, tall / 2 - 0.01), 0.005, sides=6) for turn in even_turns(3)]


def picture_frame(rng: np.random.Generator) -> Parts:
    """An empty oval or rectangular frame with up to three bars; some stand on two legs like an easel."""
    width, height, thick = rng.uniform(0.6, 1), rng.uniform(0.6, 1), rng.uniform(0.03, 0.08)
    rim = rng.uniform(0.06, 0.16)
    outline = circle(1, 48)
    if rng.random() < 0.6:
        # Move the points of the circle outwards to a square of side 2; four become its corners.
        outline /= np.abs(outline).max(axis=1, keepdims=True)
    outer, inner = outline * (width / 2, height / 2), outline * (width / 2 - rim, height / 2 - rim)
    yield extruded(outer, thick, inner)
    if rng.random() < 0.5:
        foot = np.array([0, -height / 2, -0.5 * height])
        yield from [rod((0, height / 2 - rim / 2, 0.01), foot + (side * 0.15, 0, 0), 0.015) for side in (-1, 1)]
    bars = int(rng.integers(0, 4))
    for x in (np.arange(bars) + 1) / (bars + 1) - 0.5:
        bar, half = x * (width - 2 * rim), height / 2 - rim / 2
        yield rod((bar, -half, thick / 2), (bar, half, thick / 2), 0.012)


def lattice_panel(rng: np.random.Generator) -> Parts:
    """A board with rows and columns of rectangular holes, some of which are missing."""
    rows, columns = int(rng.integers(2, 8)), int(rng.integers(2, 8))
    solid = np.ones((2 * rows + 1, 2 * columns + 1), bool)
    solid[1::2, 1::2] = rng.random((rows, columns)) >= rng.uniform(0.6, 1)
    bar = rng.uniform(0.15, 0.6)
    sizes = (np.where(np.arange(n) % 2, rng.uniform(0.7, 1.4, n), bar) for n in (2 * columns + 1, 2 * rows + 1))
    x, y = (np.concatenate([[0], np.cumsum(size)]) for size in sizes)
    yield extruded_cells(solid, x, y, rng.uniform(0.1, 0.8))


def clothes_rack(rng: np.random.Generator) -> Parts:
    """A rail on two pairs of legs, with wire hangers."""
    width, height, pipe = rng.uniform(0.8, 1.4), rng.uniform(0.9, 1.3), rng.uniform(0.012, 0.02)
    yield rod((-width / 2, 0, height), (width / 2, 0, height), pipe, sides=10)
    for side in (-1, 1):
        top = (side * width * 0.45, 0.0, height + 0.01)
        yield from [rod((side * width * 0.45, y, 0.0), top, pipe) for y in (-0.25, 0.25)]
    yield sweep(rectangle(0.03, 0.012), [(-width * 0.45, 0, 0.25 * height), (width * 0.45, 0, 0.25 * height)])
    for x in np.sort(rng.uniform(-0.4, 0.4, int(rng.integers(3, 9)))) * width:
        wide, drop = rng.uniform(0.16, 0.24), rng.uniform(0.1, 0.16)
        hook = spline([(0.03, 0.01), (0, 0.03), (-0.03, 0.01), (-0.01, -0.03), (0, -0.06)], 4) + (0, -0.01)
        turn = about_z(rng.uniform(-0.4, 0.4))
        hanger = np.array([(0, -0.06), (wide, -0.06 - drop), (-wide, -0.06 - drop)])
        at = np.array([x, 0, height])
        hook, hanger = (lift(curve, "yz") @ turn.T + at for curve in (hook, hanger))
        yield wire(hook, 0.006, 6)
        yield from [rod(hanger[i], hanger[(i + 1) % 3], 0.006, sides=6) for i in range(3)]
