#!/usr/bin/env python3
"""How time and memory grow with the triangles of a scene and with the patches of the coarse solve.

    python3 bench/growth.py                                              # about two minutes, on a quiet machine
    python3 bench/growth.py --out bench/runs/2026-11-21-growth.md        # where a dated run is kept
    python3 bench/growth.py --triangles 1000 10000 --qualities draft     # shorter

Prints a Markdown table, and writes it to --out.  Scenes are made in out/growth.  Method: bench/README.md.
"""
import argparse, json, math, os, random, re, subprocess, sys

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)
sys.path[:0] = [HERE, os.path.join(ROOT, 'scenes')]
import make_scenes as make
from measure import built, example, machine, timed

WIDTH = 256
# n log n has a slope of 1 + 1/ln n in logarithms, 1.09 at 10⁵; more than this is worse.
STEEP = 1.15
# Stages below this share of the largest run are not listed.
SHARE = 0.05


# --------------------------------------------------------------------------------------------------------------- scenes

def room(note):
    s = make.Scene(note)
    lo, hi = (-2, 0, -2), (2, 2.4, 2)
    s.room(lo, hi, make.WHITE, left=make.diffuse('red', (0.6, 0.2, 0.15)), right=make.diffuse('blue', (0.2, 0.3, 0.6)))
    lamp(s)
    return s


def lamp(s):
    s.put('lamp', make.light('lamp', (1.0, 0.9, 0.75), 12), make.quad((-0.5, 2.38, -0.5), (0.5, 2.38, -0.5), (0.5, 2.38, 0.5), (-0.5, 2.38, 0.5), towards=(0, -1, 0)))
    s.camera((0, 1.2, 1.95), (0, 0.8, -1), 70)


def balls(count):
    """Nine smooth balls, cut ever finer: curved surfaces, whose triangles are faces of their own."""
    s = room('nine balls')
    n = max(4, round(math.sqrt(count / 9)))
    one = make.lathe([make.arc(0, 0, 0.3, -90, 90, max(2, n // 2))], n)
    for k in range(9):
        s.put(f'ball_{k}', make.WHITE, one, at=(k % 3 * 1.0 - 1, 0.32 + 0.2 * (k % 2), k // 3 * 1.0 - 1.4))
    return s


def boxes(count):
    """Ever more and smaller boxes on the floor, turned by chance: flat surfaces, shadows and contacts."""
    s = room('boxes on a floor')
    rng = random.Random(1)
    side = max(1, round(math.sqrt(count / 10)))
    pitch, all_boxes = 3.6 / side, make.Mesh()
    for k in range(side * side):
        x, z = (k % side + 0.5) * pitch - 1.8, (k // side + 0.5) * pitch - 1.8
        half, height = 0.25 * pitch, pitch * rng.uniform(0.3, 0.9)
        all_boxes.merge(make.box((-half, 0, -half), (half, height, half), ('bottom',)).turn(rng.uniform(0, 90)).move(x, 0, z))
    s.put('boxes', make.diffuse('ochre', (0.65, 0.48, 0.2)), all_boxes)
    return s


def walls(count):
    """Five walls cut into a grid: coplanar triangles, and two boxes for shadows."""
    s = make.Scene('a room of many triangles')
    n = max(1, round(math.sqrt(count / 10)))
    lo, hi = (-2, 0, -2), (2, 2.4, 2)
    for side in ('bottom', 'top', 'left', 'right', 'back'):
        a, b, c, d = make.side_of_box(lo, hi, side)
        towards = make.mul(make.SIDES[side], -1)
        at = lambda i, j: make.add(a, make.add(make.mul(make.sub(b, a), i / n), make.mul(make.sub(d, a), j / n)))
        grid = [at(i, j) for j in range(n + 1) for i in range(n + 1)]
        faces = [f for j in range(n) for i in range(n) for k in [j * (n + 1) + i] for f in ((k, k + 1, k + n + 2), (k, k + n + 2, k + n + 1))]
        s.put(side, make.WHITE, make.Mesh().smooth(grid, [towards] * len(grid), faces))
    s.put('boxes', make.diffuse('ochre', (0.65, 0.48, 0.2)), make.box((-1, 0, -1), (-0.3, 1.2, -0.3)), make.box((0.3, 0, -0.2), (0.9, 0.6, 0.4)))
    lamp(s)
    return s


FAMILIES = {'balls': balls, 'boxes': boxes, 'walls': walls}


# -------------------------------------------------------------------------------------------------------------- measure

def over_triangles(a, folder, say):
    for family in a.families:
        for quality in a.qualities:
            rows = []
            for count in a.triangles:
                scene = os.path.join(folder, f'{family}_{count}.glb')
                # By a process of its own: what this one holds would count as the memory of those that it starts.
                subprocess.check_call([sys.executable, os.path.abspath(__file__), '--make', family, str(count), scene])
                report = os.path.join(folder, 'report.json')
                row = timed([a.catoptric, 'render', scene, '-o', os.path.join(folder, f'{family}_{count}.exr'), '--size', str(WIDTH),
                             '--quality', quality, '--quiet', '--json', report], a.limit)
                if row is None:
                    say(f'\n{family} at {count} triangles, {quality}: given up after {a.limit} s')
                    break
                with open(report) as f:
                    found = json.load(f)
                row.update(n=found['scene']['triangles'], vertices=found['solve']['vertices'],
                           stages={s['name']: s['seconds'] for s in found['stages']})
                rows.append(row)
            table(say, f'{family}, `{quality}`', 'triangles', rows)


def over_patches(a, folder, say):
    quick = example('quick')
    for scene in a.scenes:
        rows = []
        for base in a.patches:
            row = timed([quick, os.path.join(ROOT, 'scenes', scene + '.glb'), os.path.join(folder, 'patches.exr'), 'standard'], a.limit,
                        dict(os.environ, BASE=str(base)))
            if row is None:
                say(f'\n{scene} with {base} base triangles: given up after {a.limit} s')
                break
            # "12.3 ms (23.4 of processors) sources"
            stages = re.findall(r'^ *([0-9.]+) ms (?:\(.*\) )?(.*)$', row['errors'], re.MULTILINE)
            row.update(n=number(row['errors'], 'patches: '), vertices=number(row['errors'], ' vertices: '), stages={})
            for milliseconds, stage in stages:
                row['stages'][stage] = row['stages'].get(stage, 0) + float(milliseconds) / 1e3
            rows.append(row)
        table(say, f'{scene}, `standard`, base triangles {a.patches[0]} to {a.patches[-1]}', 'patches', rows)


def number(text, after):
    digits = text.split(after, 1)[1]
    return int(digits[:next(i for i, c in enumerate(digits) if not c.isdigit())])


# ------------------------------------------------------------------------------------------------------------------ fit

def slope(rows, value):
    """of the logarithms by least squares over the upper half of the range, where constants matter less; over the last two runs at least"""
    if len(rows) < 2:
        return math.nan
    half = [r for r in rows if r['n'] ** 2 >= rows[0]['n'] * rows[-1]['n'] * 0.99]
    upper = [(math.log(r['n']), math.log(max(value(r), 1e-6))) for r in (half if len(half) > 1 else rows[-2:])]
    x, y = (sum(p[i] for p in upper) / len(upper) for i in (0, 1))
    return sum((p - x) * (q - y) for p, q in upper) / sum((p - x) ** 2 for p, _ in upper)


def table(say, title, unit, rows):
    if len(rows) < 2:
        return
    stages = [s for s in rows[-1]['stages'] if rows[-1]['stages'][s] > SHARE * rows[-1]['seconds']]
    say(f'\n## {title}\n\n| {unit} | seconds | CPU seconds | MB | vertices |' + ''.join(f' {s} |' for s in stages))
    say('|---' * (5 + len(stages)) + '|')
    for r in rows:
        cells = ''.join(f' {r["stages"].get(s, 0):.2f} |' for s in stages)
        say(f'| {r["n"]} | {r["seconds"]:.2f} | {r["cpu"]:.2f} | {r["mb"]:.0f} | {r["vertices"]} |' + cells)

    def mark(k):
        return f'**{k:.2f}**' if k > STEEP else f'{k:.2f}'
    columns = [lambda r, k=k: r[k] for k in ('seconds', 'cpu', 'mb', 'vertices')] + [lambda r, s=s: r['stages'].get(s, 0) for s in stages]
    say('| exponent |' + ''.join(f' {mark(slope(rows, column))} |' for column in columns))


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('--families', nargs='*', default=list(FAMILIES), choices=FAMILIES)
    ap.add_argument('--triangles', nargs='+', type=int, default=[1_000, 10_000, 100_000, 300_000])
    ap.add_argument('--qualities', nargs='+', default=['draft', 'standard'])
    ap.add_argument('--scenes', nargs='*', default=['cornell_box', 'interior'], help='for the patches; none: leave them out')
    ap.add_argument('--patches', nargs='+', type=int, default=[300, 1_200, 5_000, 20_000], help='base triangles')
    ap.add_argument('--limit', type=float, default=600, help='seconds after which a run is given up')
    ap.add_argument('--catoptric', help='the program; without it `cargo build --release` makes one')
    ap.add_argument('--out', help='Markdown file')
    ap.add_argument('--make', nargs=3, metavar=('FAMILY', 'TRIANGLES', 'FILE'), help='writes one scene, no more')
    a = ap.parse_args()
    if a.make:
        family, count, file = a.make
        FAMILIES[family](int(count)).write(file)
        return
    a.catoptric = a.catoptric or built()
    folder = os.path.join(ROOT, 'out', 'growth')
    os.makedirs(folder, exist_ok=True)
    lines = []

    def say(text):
        print(text, flush=True)
        lines.append(text)
    say(f'# {machine()}: growth\n\n`python3 bench/growth.py`: {WIDTH} pixels wide, wall and processor time of the whole program, peak resident\n'
        f'memory, stages of more than {SHARE:.0%} of the largest run. Exponents: slopes of the logarithms over the upper half of the range; n log n\n'
        f'has 1.09 at 10⁵; above {STEEP} they are bold.')
    over_triangles(a, folder, say)
    over_patches(a, folder, say)
    if a.out:
        with open(a.out, 'w') as f:
            f.write('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
