#!/usr/bin/env python3
"""Instructions that small runs of the program take, against the committed table: finds what slowed down on any machine, busy or not.

    python3 bench/instructions.py                    # about five minutes; exit 1 where a run takes more than the table says
    python3 bench/instructions.py --update           # an explicit act: writes the table, bench/instructions.tsv
    python3 bench/instructions.py solve_mirror       # one of them; its profile by function lies in out/instructions

Needs valgrind.  Method: bench/README.md.
"""
import argparse, os, re, shutil, subprocess, sys

from measure import ROOT, built

TABLE = os.path.join(ROOT, 'bench', 'instructions.tsv')
# Runs of one binary differ by less than 0.1 %: threads wait for each other now and then.
TOLERANCE = 0.02
DRAFT = ['--quality', 'draft', '--threads', '1', '--quiet']

# name: what is measured, and what is made before it.
RUNS = {
    # Pass one, by what the scene is lit by.
    'solve_box': (['solve', 'cornell_box', '-o', 'box.glb', *DRAFT], None),
    'solve_mirror': (['solve', 'cornell_mirror', '-o', 'mirror.glb', *DRAFT], None),
    'solve_shaft': (['solve', 'mirror_light_shaft', '-o', 'shaft.glb', *DRAFT], None),
    'solve_ring': (['solve', 'ring_caustic', '-o', 'ring.glb', *DRAFT], None),
    'solve_glass': (['solve', 'glass_sphere', '-o', 'glass.glb', *DRAFT], None),
    'solve_contacts': (['solve', 'contacts', '-o', 'contacts.glb', *DRAFT], None),
    # Pass two.
    'view_mirror': (['render', 'mirror.glb', '-o', 'mirror.exr', '--size', '256', *DRAFT], 'solve_mirror'),
    'view_glass': (['render', 'glass.glb', '-o', 'glass.exr', '--size', '256', *DRAFT], 'solve_glass'),
    'view_pixels': (['render', 'mirror.glb', '-o', 'pixels.exr', '--direct', 'pixels', '--size', '128', *DRAFT], 'solve_mirror'),
    # Reading a large file, its tree, and the cut into faces by which `info` says what pass one costs.
    'read_interior': (['info', 'interior'], None),
    # Kernels: the contour formula, walks, hemicubes, points on pairs of patches.
    'factors_analytic': (['form-factors', 'cornell_box', '-o', 'F.csv', '--method', 'analytic', '--tolerance', '0.01', '--threads', '1', '--quiet'], None),
    'factors_rays': (['form-factors', 'cornell_mirror', '-o', 'F.csv', '--rays', '4096', '--threads', '1', '--quiet'], None),
    'factors_hemicube': (['form-factors', 'cornell_box', '-o', 'F.csv', '--method', 'hemicube', '--resolution', '32', '--threads', '1', '--quiet'], None),
    'factors_area': (['form-factors', 'cornell_box', '-o', 'F.csv', '--method', 'area', '--rays', '256', '--threads', '1', '--quiet'], None),
    # A solver with rows and unknowns of its own.
    'solve_southwell': (['solve', 'cornell_box', '-o', 'southwell.glb', '--solver', 'southwell', *DRAFT], None),
}


def count(program, folder, name):
    """-> instructions of a run"""
    def command(words):
        scenes = {w: os.path.join(ROOT, 'scenes', w + '.glb') for w in words if os.path.exists(os.path.join(ROOT, 'scenes', w + '.glb'))}
        return [program, *(scenes.get(w, w) for w in words)]
    words, before = RUNS[name]
    if before:
        subprocess.check_call(command(RUNS[before][0]), cwd=folder, stdout=subprocess.DEVNULL)
    # An environment of its own: its size moves the stack, its words may change what is printed.
    run = subprocess.run(['valgrind', '--tool=cachegrind', '--cache-sim=no', f'--cachegrind-out-file={name}.cachegrind', *command(words)],
                         cwd=folder, env={'PATH': os.environ['PATH']}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    found = re.search(r'I\s+refs:\s+([\d,]+)', run.stderr)
    if run.returncode != 0 or not found:
        sys.exit(f'{name} failed:\n{run.stderr}')
    return int(found.group(1).replace(',', ''))


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('runs', nargs='*', metavar='RUN', help=', '.join(RUNS))
    ap.add_argument('--update', action='store_true', help='write the table')
    a = ap.parse_args()
    unknown = set(a.runs) - set(RUNS)
    if unknown:
        ap.error(f'no such run: {", ".join(sorted(unknown))}')
    if not shutil.which('valgrind'):
        sys.exit('valgrind is missing: apt-get install valgrind')
    program = os.path.abspath(built())
    folder = os.path.join(ROOT, 'out', 'instructions')
    os.makedirs(folder, exist_ok=True)
    table = {}
    if os.path.exists(TABLE):
        with open(TABLE) as f:
            table = {name: int(n) for name, n in (line.split() for line in f if not line.startswith('#'))}

    worse = []
    print('| run | million instructions | table | change |\n|---|---|---|---|')
    for name in a.runs or RUNS:
        now, before = count(program, folder, name), table.get(name)
        change = now / before - 1 if before else None
        if before and change > TOLERANCE and not a.update:
            worse.append(name)
        shown = f'{before / 1e6:.1f} | {change:+.1%}' if before else '– | new'
        print(f'| {name} | {now / 1e6:.1f} | {shown}{" **more**" if name in worse else ""} |', flush=True)
        table[name] = now
    if a.update:
        with open(TABLE, 'w') as f:
            f.write('# Instructions per run, by `python3 bench/instructions.py --update`.\n')
            f.writelines(f'{name}\t{table[name]}\n' for name in RUNS if name in table)
    if worse:
        sys.exit(f'more than {TOLERANCE:.0%} above the table: {", ".join(worse)}')


if __name__ == '__main__':
    main()
