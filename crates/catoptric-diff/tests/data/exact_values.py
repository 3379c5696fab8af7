#!/usr/bin/env python3
"""Computes exact.json: small images in integer code values over a scale, and their metrics by a second method.

Sums are exact fractions; SSIM is the plain double loop over windows.  Needs nothing but Python.
"""
import json, math, os
from fractions import Fraction as F


def lcg(seed):
    while True:
        seed = (seed * 1103515245 + 12345) % 2**31
        yield seed >> 16


def pictures():
    g, h = lcg(1), lcg(2)
    ramp = [[(7 * x + 11 * y) % 256 for x in range(16)] for y in range(16)]
    yield "ramp against ramp plus one", 255, ramp, [[min(v + 1, 255) for v in row] for row in ramp]
    yield "noise against noise", 255, [[next(g) % 256 for _ in range(17)] for _ in range(13)], [[next(h) % 256 for _ in range(17)] for _ in range(13)]
    yield "flat against flat", 8, [[4] * 12 for _ in range(11)], [[6] * 12 for _ in range(11)]
    yield "one pixel wrong", 16, [[8 + (x == 5 and y == 6) * 8 for x in range(14)] for y in range(12)], [[8] * 14 for _ in range(12)]
    yield "black reference", 4, [[1] * 11 for _ in range(11)], [[0] * 11 for _ in range(11)]
    yield "equal", 100, ramp, ramp


def ssim(a, b, scale):
    k = [math.exp(-(i - 5) ** 2 / 4.5) for i in range(11)]
    s = sum(k)
    w = [[p * q / s / s for p in k] for q in k]
    h, n, total = len(a), len(a[0]), []
    for y in range(h - 10):
        for x in range(n - 10):
            A = [(w[j][i], a[y + j][x + i] / scale, b[y + j][x + i] / scale) for j in range(11) for i in range(11)]
            ma, mb = sum(q * p for q, p, _ in A), sum(q * r for q, _, r in A)
            va, vb = sum(q * (p - ma) ** 2 for q, p, _ in A), sum(q * (r - mb) ** 2 for q, _, r in A)
            c = sum(q * (p - ma) * (r - mb) for q, p, r in A)
            total.append((2 * ma * mb + 1e-4) * (2 * c + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4)))
    return math.fsum(total) / len(total)


cases = []
for name, scale, test, reference in pictures():
    pixels = [(F(t, scale), F(r, scale)) for a, b in zip(test, reference) for t, r in zip(a, b)]
    n = len(pixels)
    mse = sum((t - r) ** 2 for t, r in pixels) / n
    mean2 = sum(r * r for _, r in pixels) / n
    values = {
        "MSE": float(mse),
        "RMSE": math.sqrt(mse),
        "MAE": float(sum(abs(t - r) for t, r in pixels) / n),
        "relMSE": float(sum((t - r) ** 2 / (r * r + F(1, 100)) for t, r in pixels) / n),
        "SSIM": ssim(test, reference, scale),
        "max_abs": float(max(abs(t - r) for t, r in pixels)),
    }
    if mean2 > 0:
        values["MRSE"] = float(sum((t - r) ** 2 / (r * r + F(1, 10000) * mean2) for t, r in pixels) / n)
        values["energy_G"] = float(sum(t for t, _ in pixels) / sum(r for _, r in pixels))
    if mse > 0:
        values["PSNR"] = -10 * math.log10(mse)
    cases.append({"name": name, "scale": scale, "test": test, "reference": reference, "values": values})
with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "exact.json"), "w") as file:
    json.dump(cases, file)
