#!/usr/bin/env python3
"""Derives cases.json: exact form factors and solver counts, each by two independent methods.

Closed forms: Howell's catalogue C-11 (equal parallel rectangles) and C-14 (rectangles with a common edge), evaluated
from their formulas; other arrangements follow by form factor algebra (superposition and reciprocity). Second method:
numerical integration (scipy) of the point formulas B-3 and B-4, which share no code with the closed forms.

    python3 reference/analytic/derive.py > reference/analytic/cases.json
"""
import json
import sys
from math import atan, log, pi, sqrt

import numpy as np
from scipy.integrate import dblquad


def parallel(a, b, c):
    """C-11: equal rectangles a x b, opposite each other at distance c."""
    x, y = a / c, b / c
    rx, ry = sqrt(1 + x * x), sqrt(1 + y * y)
    return 2 / (pi * x * y) * (
        log(rx * ry / sqrt(1 + x * x + y * y))
        + x * ry * atan(x / ry) + y * rx * atan(y / rx) - x * atan(x) - y * atan(y))


def common_edge(width, height, length):
    """C-14: floor length x width to wall length x height at right angles, common edge `length`."""
    h, w = height / length, width / length
    a = (1 + w * w) * (1 + h * h) / (1 + w * w + h * h)
    b = w * w * (1 + w * w + h * h) / ((1 + w * w) * (w * w + h * h))
    c = h * h * (1 + w * w + h * h) / ((1 + h * h) * (w * w + h * h))
    return 1 / (pi * w) * (
        w * atan(1 / w) + h * atan(1 / h) - sqrt(h * h + w * w) * atan(1 / sqrt(h * h + w * w))
        + 0.25 * (log(a) + w * w * log(b) + h * h * log(c)))


def over(x, y, c):
    """B-3 for a rectangle with one corner above the point; odd in x and y."""
    x, y = x / c, y / c
    rx, ry = sqrt(1 + x * x), sqrt(1 + y * y)
    return (x / rx * atan(y / rx) + y / ry * atan(x / ry)) / (2 * pi)


def over_array(x, y, c):
    """B-3 for all pairs of corner coordinates."""
    x, y = x[:, None] / c, y[None, :] / c
    rx, ry = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    return (x / rx * np.arctan(y / rx) + y / ry * np.arctan(x / ry)) / (2 * pi)


def over_rectangle(px, py, x0, x1, y0, y1, c):
    """Point (px, py, 0) looking up at the rectangle [x0, x1] x [y0, y1] at height c."""
    if x1 <= x0 or y1 <= y0:
        return 0.0
    f = lambda x, y: over(x - px, y - py, c)
    return f(x1, y1) - f(x0, y1) - f(x1, y0) + f(x0, y0)


def beside(distance, y, z):
    """B-4: wall at `distance`, from the foot of the perpendicular to y, from the floor to z; odd in y."""
    if distance <= 0:
        return 0.25 if y > 0 else -0.25
    r = sqrt(distance * distance + z * z)
    return (atan(y / distance) - distance / r * atan(y / r)) / (2 * pi)


def mean(function, x0, x1, y0, y1):
    value, _ = dblquad(lambda y, x: function(x, y), x0, x1, y0, y1, epsabs=1e-11, epsrel=1e-11)
    return value / ((x1 - x0) * (y1 - y0))


def rectangle(name, origin, a, b, rho_d=0.0, rho_s=0.0):
    o, a, b = np.array(origin, float), np.array(a, float), np.array(b, float)
    return dict(name=name, shape="polygon", vertices=[list(map(float, v)) for v in (o, o + a, o + a + b, o + b)],
                rho_d=rho_d, rho_s=rho_s)


CASES = []


def case(group, name, geometry, quantity, value, formula, source, verify, second, tolerance=1e-6, note=""):
    relative = abs(second - value) / abs(value)
    if relative > 2e-8:
        sys.exit(f"{name}: {value} by {source}, {second} by {verify}: {relative:.1e} apart")
    number = sum(c["group"] == group for c in CASES) + 1
    CASES.append(dict(id=f"{group}{number:02}", group=group, name=name, geometry=geometry, quantity=quantity, value=value,
                      digits=8, formula=formula, source=source, tolerance=tolerance,
                      verify=f"{verify}: {relative:.1e} apart", note=note))


def pair(*surfaces):
    return dict(surfaces=list(surfaces), sender=surfaces[0]["name"], receiver=surfaces[1]["name"])


def group_a():
    for a, b, c in [(1, 1, 1), (2, 1, 0.5), (1, 3, 2), (0.2, 0.3, 1), (5, 4, 0.25), (1, 1, 8)]:
        exact = parallel(a, b, c)
        second = mean(lambda x, y: over_rectangle(x, y, 0, a, 0, b, c), 0, a, 0, b)
        geometry = pair(rectangle("floor", (0, 0, 0), (a, 0, 0), (0, b, 0)),
                        rectangle("ceiling", (0, 0, c), (0, b, 0), (a, 0, 0)))
        case("A", f"parallel rectangles {a} x {b} at {c}", geometry, "F(floor->ceiling)", exact, "C-11",
             "Howell C-11", "dblquad of B-3", second)
    for w, h, l in [(1, 1, 1), (2, 1, 1), (0.5, 3, 2), (1, 0.1, 4), (3, 3, 0.5)]:
        exact = common_edge(w, h, l)
        second = mean(lambda x, y: beside(x, l - y, h) + beside(x, y, h), 0, w, 0, l)
        geometry = pair(rectangle("floor", (0, 0, 0), (w, 0, 0), (0, l, 0)),
                        rectangle("wall", (0, 0, 0), (0, l, 0), (0, 0, h)))
        case("A", f"floor {w} x {l} and wall of height {h} with a common edge", geometry, "F(floor->wall)", exact,
             "C-14", "Howell C-14", "dblquad of B-4", second, note="a common edge")
    for w, h, l, gap in [(1, 1, 1, 0.5), (2, 1, 3, 0.1)]:
        # Floor from gap to gap + w: A F = (gap + w) l F(gap + w) - gap l F(gap).
        exact = ((gap + w) * common_edge(gap + w, h, l) - gap * common_edge(gap, h, l)) / w
        second = mean(lambda x, y: beside(x, l - y, h) + beside(x, y, h), gap, gap + w, 0, l)
        geometry = pair(rectangle("floor", (gap, 0, 0), (w, 0, 0), (0, l, 0)),
                        rectangle("wall", (0, 0, 0), (0, l, 0), (0, 0, h)))
        case("A", f"the same with a gap of {gap}", geometry, "F(floor->wall)", exact, "superposition of C-14",
             "Howell C-14", "dblquad of B-4", second)
    for w, h, l, below in [(1, 1, 1, 0.5), (1.5, 0.7, 2, 2)]:
        exact = common_edge(w, h, l)
        second = mean(lambda x, y: beside(x, l - y, h) + beside(x, y, h), 0, w, 0, l)
        geometry = pair(rectangle("floor", (0, 0, 0), (w, 0, 0), (0, l, 0)),
                        rectangle("wall", (0, 0, -below), (0, l, 0), (0, 0, h + below)))
        case("A", f"a wall that goes on {below} below the floor's plane", geometry, "F(floor->wall)", exact,
             "C-14: what is below the horizon gives nothing", "Howell C-14", "dblquad of B-4", second,
             note="the horizon cuts the wall")
    for s in (1, 0.5):
        # Diagonal neighbours on parallel planes touch nothing: offset by a whole width in x.
        exact = parallel(2 * s, 1, 1) - parallel(s, 1, 1)
        second = mean(lambda x, y: over_rectangle(x, y, s, 2 * s, 0, 1, 1), 0, s, 0, 1)
        geometry = pair(rectangle("floor", (0, 0, 0), (s, 0, 0), (0, 1, 0)),
                        rectangle("ceiling", (s, 0, 1), (0, 1, 0), (s, 0, 0)))
        case("A", f"parallel rectangles offset by their width {s}", geometry, "F(floor->ceiling)", exact,
             "F(2s) - F(s)", "superposition of C-11", "dblquad of B-3", second)


def clip(low, high, a, b):
    return max(low, a), min(high, b)


def group_b():
    for side, height, size, c in [(1, 0.5, 0.5, 1), (1, 0.3, 0.4, 1), (2, 0.75, 0.6, 1.5)]:
        x0, x1 = (side - size) / 2, (side + size) / 2
        stretch = c / height

        def hidden(x, y):
            px0, px1 = clip(x + (x0 - x) * stretch, x + (x1 - x) * stretch, 0, side)
            py0, py1 = clip(y + (x0 - y) * stretch, y + (x1 - y) * stretch, 0, side)
            return over_rectangle(x, y, px0, px1, py0, py1, c)

        # The shadow is cut off where it leaves the ceiling: integrate between the kinks.
        kinks = sorted({0.0, side, *[k for k in ((x0 * stretch - 0) / (stretch - 1), (x1 * stretch - side) / (stretch - 1),
                                                 (x0 * stretch - side) / (stretch - 1), x1 * stretch / (stretch - 1))
                                     if 0 < k < side]})
        cells = [(a, b, p, q) for a, b in zip(kinks, kinks[1:]) for p, q in zip(kinks, kinks[1:])]
        lost = sum(mean(hidden, *cell) * (cell[1] - cell[0]) * (cell[3] - cell[2]) for cell in cells) / side**2
        exact = parallel(side, side, c) - lost
        nodes, weights = np.polynomial.legendre.leggauss(24)
        second = 0.0
        for a, b, p, q in cells:
            xs, ys = (a + b) / 2 + (b - a) / 2 * nodes, (p + q) / 2 + (q - p) / 2 * nodes
            second += (b - a) * (q - p) / 4 * sum(
                wx * wy * (over_rectangle(x, y, 0, side, 0, side, c) - hidden(x, y))
                for x, wx in zip(xs, weights) for y, wy in zip(ys, weights))
        second /= side**2
        geometry = pair(rectangle("floor", (0, 0, 0), (side, 0, 0), (0, side, 0)),
                        rectangle("ceiling", (0, 0, c), (0, side, 0), (side, 0, 0)),
                        rectangle("plate", (x0, x0, height), (size, 0, 0), (0, size, 0)))
        case("B", f"squares of {side} at {c} with a plate of {size} at {height}", geometry, "F(floor->ceiling)", exact,
             "C-11 less the shadow, a rectangle for every point", "Howell C-11, B-3", "Gauss of B-3 with the shadow",
             second, tolerance=1e-5)


def group_c():
    for a, b, c in [(1, 1, 1), (2, 1, 0.5)]:
        geometry = pair(rectangle("floor", (0, 0, 0), (a, 0, 0), (0, b, 0), 0.5),
                        rectangle("ceiling", (0, 0, c), (0, b, 0), (a, 0, 0), 0.5),
                        rectangle("x0", (0, 0, 0), (0, b, 0), (0, 0, c), 0.5),
                        rectangle("x1", (a, 0, 0), (0, 0, c), (0, b, 0), 0.5),
                        rectangle("y0", (0, 0, 0), (0, 0, c), (a, 0, 0), 0.5),
                        rectangle("y1", (0, b, 0), (a, 0, 0), (0, 0, c), 0.5))
        geometry["receiver"] = "x0"
        exact = common_edge(a, c, b)
        rest = 1 - parallel(a, b, c) - 2 * common_edge(b, c, a)
        case("C", f"closed box {a} x {b} x {c}: floor to a side", geometry, "F(floor->x0)", exact, "C-14", "Howell C-14",
             "closure: (1 - C-11 - 2 C-14)/2", rest / 2)


def images(a, b, c, rho_x, rho_y, count):
    """Floor to ceiling of a duct a x b x c: images at (m a, n b), by second differences of C-11.

    An image at distance r adds at most a b c^2 / (pi r^4) of rho^count or less, all beyond R = count min(a, b) together
    rho^count c^2 / R^2: 7e-11 for the worst duct below (rho 0.9, R 45, c 1). A tolerance of 1e-6 judges the method alone.
    """
    g = lambda m, n: m * n * parallel(m * a, n * b, c) if m and n else 0.0
    one = lambda f, m: (f(m + 1) - 2 * f(m) + f(m - 1)) / 2 if m else f(1)
    total = 0.0
    for m in range(count if rho_x else 1):
        for n in range(count if rho_y else 1):
            offset = one(lambda i: one(lambda j: g(i, j), n), m)
            total += (2 if m else 1) * (2 if n else 1) * rho_x**m * rho_y**n * offset
    return total


def group_d():
    for a, b, c, rho in [(1, 1, 1, 0.8), (2, 1, 0.5, 0.5), (0.5, 1, 2, 0.9)]:
        exact = parallel(a, b, c) + rho * (parallel(2 * a, b, c) - parallel(a, b, c))
        second = mean(lambda x, y: over_rectangle(x, y, 0, a, 0, b, c) + rho * over_rectangle(x, y, -a, 0, 0, b, c),
                      0, a, 0, b)
        geometry = pair(rectangle("floor", (0, 0, 0), (a, 0, 0), (0, b, 0)),
                        rectangle("ceiling", (0, 0, c), (0, b, 0), (a, 0, 0)),
                        rectangle("mirror", (0, 0, 0), (0, b, 0), (0, 0, c), 0, rho))
        case("D", f"one mirror wall of {rho} in {a} x {b} x {c}", geometry, "F^s(floor->ceiling)", exact,
             "C-11 + rho (C-11 of twice the width - C-11)", "Howell C-11", "dblquad of B-3 and its image", second)
    for a, b, c, rho in [(1, 1, 1, 0.5), (1, 2, 0.7, 0.75)]:
        exact = images(a, b, c, rho, 0, 60)
        second = mean(lambda x, y: sum(rho**abs(m) * over_rectangle(x, y, m * a, (m + 1) * a, 0, b, c)
                                       for m in range(-60, 61)), 0, a, 0, b)
        geometry = pair(rectangle("floor", (0, 0, 0), (a, 0, 0), (0, b, 0)),
                        rectangle("ceiling", (0, 0, c), (0, b, 0), (a, 0, 0)),
                        rectangle("m0", (0, 0, 0), (0, b, 0), (0, 0, c), 0, rho),
                        rectangle("m1", (a, 0, 0), (0, 0, c), (0, b, 0), 0, rho))
        case("D", f"two facing mirrors of {rho} in {a} x {b} x {c}", geometry, "F^s(floor->ceiling)", exact,
             "images at m a by second differences of C-11", "Howell C-11", "dblquad of B-3 over the images", second)
    for a, b, c, rho_x, rho_y in [(1, 1, 1, 0.9, 0.9), (1, 2, 0.7, 0.5, 0.5), (2, 1, 0.5, 0.8, 0.6), (0.3, 0.4, 1, 0.9, 0.7)]:
        exact = images(a, b, c, rho_x, rho_y, 150)
        nodes, weights = np.polynomial.legendre.leggauss(20)
        xs, ys, w = (1 + nodes) / 2 * a, (1 + nodes) / 2 * b, weights / 2
        m = np.arange(-150, 151)
        corner = lambda x, y: over_array(np.arange(-150, 152) * a - x, np.arange(-150, 152) * b - y, c)
        fold = rho_x ** np.abs(m)[:, None] * rho_y ** np.abs(m)[None, :]
        second = sum(w[i] * w[j] * np.sum(fold * np.diff(np.diff(corner(x, y), axis=0), axis=1))
                     for i, x in enumerate(xs) for j, y in enumerate(ys))
        geometry = pair(rectangle("floor", (0, 0, 0), (a, 0, 0), (0, b, 0)),
                        rectangle("ceiling", (0, 0, c), (0, b, 0), (a, 0, 0)),
                        rectangle("x0", (0, 0, 0), (0, b, 0), (0, 0, c), 0, rho_x),
                        rectangle("x1", (a, 0, 0), (0, 0, c), (0, b, 0), 0, rho_x),
                        rectangle("y0", (0, 0, 0), (0, 0, c), (a, 0, 0), 0, rho_y),
                        rectangle("y1", (0, b, 0), (a, 0, 0), (0, 0, c), 0, rho_y))
        case("D", f"duct of mirrors {rho_x} and {rho_y}, {a} x {b} x {c}", geometry, "F^s(floor->ceiling)", exact,
             "images at (m a, n b) by second differences of C-11", "Howell C-11", "Gauss of B-3 over the images", second)


def counts(matrix, rho, emission, area, tolerance):
    """Steps until the largest error is below tolerance x the largest exact value. Own loops, no library."""
    n = len(rho)
    system = np.eye(n) - rho[:, None] * matrix
    exact = np.linalg.solve(system, emission)
    good = lambda x: np.max(np.abs(x - exact)) <= tolerance * np.max(np.abs(exact))
    result = {}
    x, k = np.zeros(n), 0
    while not good(x):
        x = (emission + rho * (matrix @ x - np.diag(matrix) * x)) / np.diag(system)
        k += 1
    result["jacobi"] = k
    x, k = np.zeros(n), 0
    while not good(x):
        for i in range(n):
            x[i] = (emission[i] - sum(system[i, j] * x[j] for j in range(n) if j != i)) / system[i, i]
        k += 1
    result["gauss-seidel"] = k
    x, unshot, k = emission.copy(), emission.copy(), 0
    while not good(x):
        i = int(np.argmax(area * unshot))
        received = rho * matrix[i] * unshot[i] * area[i] / area
        unshot[i] = 0
        x, unshot, k = x + received, unshot + received, k + 1
    result["progressive"] = k
    return exact, result


def group_f():
    for index, (a, b, c) in enumerate([(1, 1, 1), (2, 1, 0.5), (3, 2, 1)]):
        area = np.array([a * b, a * b, b * c, b * c, a * c, a * c], float)
        fz, fx, fy = parallel(a, b, c), parallel(b, c, a), parallel(a, c, b)
        zx, zy = common_edge(a, c, b), common_edge(b, c, a)
        f = np.zeros((6, 6))
        f[0, 1] = f[1, 0] = fz
        f[2, 3] = f[3, 2] = fx
        f[4, 5] = f[5, 4] = fy
        # Faces z, x, y in pairs: A F is symmetric.
        for (i0, f_), (j0, _) in [((0, zx), (2, 0)), ((0, zy), (4, 0))]:
            for i in (i0, i0 + 1):
                for j in (j0, j0 + 1):
                    f[i, j] = f_
                    f[j, i] = f_ * area[i] / area[j]
        for i in (2, 3):
            for j in (4, 5):
                f[i, j] = (1 - f[i].sum() + (f[i, 4] + f[i, 5])) / 2
                f[j, i] = f[i, j] * area[i] / area[j]
        rho = np.array([0.3, 0.7, 0.5, 0.5, 0.6, 0.4])
        emission = np.array([0, 10.0, 0, 1.0 if index else 0, 0, 0])
        exact, result = counts(f, rho, emission, area, 1e-6)
        residual = np.max(np.abs(exact - emission - rho * (f @ exact)))
        if residual > 1e-12:
            sys.exit("group F: the exact solution is none")
        number = index + 1
        CASES.append(dict(id=f"F{number:02}", group="F", name=f"box {a} x {b} x {c}, one element per wall",
                          geometry=dict(order=["z0", "z1", "x0", "x1", "y0", "y1"], areas=area.tolist(),
                                        F=f.tolist(), rho_d=rho.tolist(), emission=emission.tolist()),
                          quantity="iterations to 1e-6 in the maximum norm",
                          value=dict(radiosity=exact.tolist(), **result), digits=8,
                          formula="Jacobi, Gauss-Seidel, largest unshot power first", source="C-11, C-14, closure",
                          tolerance=1e-6, verify=f"the equation itself: {residual:.1e}", note=""))


def contour(point, normal, corners):
    """Lambert's formula for a polygon that is wholly above the horizon, seen counter-clockwise from behind."""
    r = [(np.array(c) - point) / np.linalg.norm(np.array(c) - point) for c in corners]
    total = 0.0
    for a, b in zip(r, r[1:] + r[:1]):
        cross = np.cross(a, b)
        total += np.arccos(np.clip(a @ b, -1, 1)) * (normal @ cross) / np.linalg.norm(cross)
    return abs(total) / (2 * pi)


def over_area(point, normal, lamp):
    """The same by integration over the lamp."""
    o, a, b = (np.array(v, float) for v in lamp)
    n = np.cross(a, b)
    area, n = np.linalg.norm(n), n / np.linalg.norm(n)

    def kernel(v, u):
        d = o + u * a + v * b - point
        r2 = d @ d
        return max(normal @ d, 0) * max(-(n @ d), 0) / (pi * r2 * r2)
    return area * dblquad(kernel, 0, 1, 0, 1, epsabs=1e-12, epsrel=1e-12)[0]


def group_e():
    def lamp_case(name, lamp, point, normal, exitance=100.0, mirror=None):
        point, normal = np.array(point, float), np.array(normal, float) / np.linalg.norm(normal)
        o, a, b = (np.array(v, float) for v in lamp)
        corners = [o, o + a, o + a + b, o + b]
        exact = exitance * contour(point, normal, corners)
        second = exitance * over_area(point, normal, lamp)
        surfaces = [dict(rectangle("lamp", *lamp), emission=exitance)]
        if mirror:
            # The mirror is the plane x = 0: the image of the lamp has x turned round.
            rho, flip = mirror, np.array([-1.0, 1, 1])
            exact += exitance * rho * contour(point, normal, [c * flip for c in corners])
            second += exitance * rho * over_area(point, normal, (o * flip + b * flip, a * flip, -b * flip))
            surfaces.append(rectangle("mirror", (0, -50, -50), (0, 100, 0), (0, 0, 100), 0, rho))
        geometry = dict(surfaces=surfaces, point=point.tolist(), normal=normal.tolist())
        case("E", name, geometry, "irradiance", exact, "Lambert's contour formula", "Lambert 1760", "dblquad over the lamp",
             second)
    down = ((-0.5, -0.5, 2), (0, 1, 0), (1, 0, 0))
    lamp_case("square lamp straight above", down, (0, 0, 0), (0, 0, 1))
    lamp_case("square lamp off to the side", down, (1.5, 0.7, 0), (0, 0, 1))
    lamp_case("square lamp and a tilted receiver", down, (1.5, 0.7, 0), (-1, 0.3, 1.2))
    lamp_case("long lamp beside a floor", ((0, -2, 0.5), (0, 4, 0), (0, 0, 0.25)), (1, 0.3, 0), (0, 0, 1))
    lamp_case("square lamp and its image in a wall of 0.8", ((1, -0.5, 2), (0, 1, 0), (1, 0, 0)), (1.2, 0.4, 0), (0, 0, 1), mirror=0.8)

    def light_case(name, exponent, flux, position, direction, point, normal):
        d = np.array(point, float) - np.array(position, float)
        r = np.linalg.norm(d)
        cos, cos_there = d @ direction / r, -(d @ np.array(normal, float)) / r
        if exponent is None:
            peak, second_peak, share = flux / (4 * pi), flux / dblquad(lambda p, t: np.sin(t), 0, pi, 0, 2 * pi)[0], 1
        else:
            peak = flux * (exponent + 1) / (2 * pi)
            second_peak = flux / dblquad(lambda p, t: np.cos(t)**exponent * np.sin(t), 0, pi / 2, 0, 2 * pi)[0]
            share = cos**exponent
        geometry = dict(surfaces=[], light=dict(exponent=exponent, peak=peak, position=position, direction=direction),
                        point=point, normal=normal)
        case("E", name, geometry, "irradiance", peak * share * cos_there / r**2, "phi (n+1)/2pi cos^n cos/r^2, or phi/4pi cos/r^2",
             "S integrates to 1", "the peak from an integrated distribution", second_peak * share * cos_there / r**2)
    for exponent in (None, 0, 1, 3, 20.5):
        name = "isotropic point" if exponent is None else f"spot with n = {exponent}"
        light_case(name, exponent, 1000.0, [0, 0, 2], [0, 0, -1], [0.6, -0.3, 0], [0, 0, 1])


for group in (group_a, group_b, group_c, group_d, group_e, group_f):
    group()
json.dump(dict(about="Our own analytic cases, made by derive.py.", cases=CASES), sys.stdout, indent=1)
print()
