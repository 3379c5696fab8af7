#!/usr/bin/env python3
"""Computes pairs.json: what NVIDIA's flip-evaluator says of the pairs in the folder `pairs`.

    pip install flip-evaluator==1.7 OpenEXR numpy pillow
    python3 flip_values.py
"""
import glob, json, os
import flip_evaluator, numpy as np, OpenEXR
from PIL import Image

here = os.path.join(os.path.dirname(os.path.abspath(__file__)), "pairs")


def read(path):
    if path.endswith(".png"):
        return np.asarray(Image.open(path), np.float32) / 255
    with OpenEXR.File(path, separate_channels=True) as file:
        channels = {k: v.pixels for k, v in file.channels().items()}
    return np.stack([np.asarray(channels[c], np.float32) for c in "RGB"], -1)


values = {}
for reference in sorted(glob.glob(os.path.join(here, "*_ref.*"))):
    name = os.path.basename(reference).split("_ref")[0]
    r, t = read(reference), read(reference.replace("_ref", "_test"))
    kind = "HDR" if name.startswith("hdr") else "LDR"
    error, mean, parameters = flip_evaluator.evaluate(r, t, kind, applyMagma=False)
    values[name] = {"mean": float(mean), "max": float(np.max(error)), "first_row": [float(v) for v in np.asarray(error).reshape(-1)[:8]],
                    "parameters": {k: float(v) for k, v in parameters.items() if isinstance(v, (int, float)) and np.isfinite(v)}}
with open(os.path.join(here, "..", "pairs.json"), "w") as file:
    json.dump(values, file, indent=1)
