#!/usr/bin/env python3
"""What FLIP would be against a reference without noise.

    python3 bench/without_noise.py out/references/showcase.exr reference/showcase.exr
    python3 bench/without_noise.py standard.exr reference/showcase.exr --truth high.exr     # how far off that is

Adds noise of the reference's own standard error to the reference, of 0, 1/2, 1, 2 and 3 times the variance that it has; FLIP² against
1 + that is taken as a line, whose value at 0 is printed. With --truth the noise is added to that image, from once the variance on, and FLIP
against the image itself stands beside. Makes its own Python environment in out/noise-venv the first time.
"""
import argparse, json, os, subprocess, tempfile

from measure import ROOT, built, in_venv

PACKAGES = ['numpy', 'OpenEXR']
MORE = [0, 0.5, 1, 2, 3]
# Draws of the noise that are averaged.
DRAWS = 2


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('image')
    ap.add_argument('reference', help='with its standard errors in the layer SE, as those in reference/')
    ap.add_argument('--truth', help='an image in place of the reference, whose noise is taken')
    ap.add_argument('--venv', default=os.path.join(ROOT, 'out', 'noise-venv'))
    a = ap.parse_args()
    in_venv(a.venv, PACKAGES)
    import numpy as np, OpenEXR
    program, random = built(), np.random.default_rng(1)

    def read(path, layer=''):
        channels = OpenEXR.File(path, separate_channels=True).channels()
        return np.stack([channels[layer + c].pixels for c in 'RGB'], -1).astype(float)
    base, error = read(a.truth or a.reference), read(a.reference, 'SE.')

    def flip(variance):
        noisy = np.maximum(base + error * variance ** 0.5 * random.standard_normal(base.shape), 0).astype('<f4')
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'noisy.pfm')
            with open(path, 'wb') as f:
                f.write(f'PF\n{base.shape[1]} {base.shape[0]}\n-1.0\n'.encode() + noisy[::-1].tobytes())
            done = subprocess.run([program, 'diff', a.image, path, '--metric', 'flip', '--json'], stdout=subprocess.PIPE)
        return json.loads(done.stdout)['layers'][0]['metrics']['FLIP']
    found = [np.mean([flip(more + bool(a.truth)) for _ in range(DRAWS)]) for more in MORE]
    for more, value in zip(MORE, found):
        print(f'{1 + more:g} times the variance: FLIP {value:.4f}')
    squared = np.polyfit(1 + np.array(MORE), np.square(found), 1)[1]
    print(f'without noise, by the line: {max(squared, 0) ** 0.5:.4f}' + (f', in truth: {flip(0):.4f}' if a.truth else ''))


if __name__ == '__main__':
    main()
