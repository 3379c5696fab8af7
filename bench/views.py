#!/usr/bin/env python3
"""What a first and a second view of every scene cost, at 1280×720 and 256 pixels wide.

    python3 bench/views.py                                               # about five minutes
    python3 bench/views.py --out bench/runs/2026-11-21-views.md          # where a dated run is kept

Prints a Markdown table, and writes it to --out.  Pictures go to out/views.  Method: bench/README.md.
"""
import argparse, json, os, statistics

from measure import ROOT, built, machine, timed

# A second view may cost so much of the first run, or so many seconds, at 256 pixels.
SHARE, SECONDS = 0.05, 0.1


def sky(name):
    return ['--sky', '1,1,1'] if name == 'sky_body' else []


def measured(a, command, report):
    """the median run of some, with the seconds of its stages"""
    runs = []
    for _ in range(a.repeats):
        run = timed([a.catoptric, *command, '--quality', a.quality, '--quiet', '--json', report], a.limit)
        if run is None:
            return None
        with open(report) as f:
            run['stages'] = {s['name']: s['seconds'] for s in json.load(f)['stages']}
        runs.append(run)
    middle = statistics.median_low(r['seconds'] for r in runs)
    return next(r for r in runs if r['seconds'] == middle)


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = sorted(f[:-4] for f in os.listdir(os.path.join(ROOT, 'scenes')) if f.endswith('.glb'))
    ap.add_argument('--scenes', nargs='+', default=names, choices=names)
    ap.add_argument('--sizes', nargs='+', default=['1280x720', '256'])
    ap.add_argument('--quality', default='standard')
    ap.add_argument('--repeats', type=int, default=1, help='the median counts')
    ap.add_argument('--limit', type=float, default=600, help='seconds after which a run is given up')
    ap.add_argument('--catoptric', help='the program; without it `cargo build --release` makes one')
    ap.add_argument('--out', help='Markdown file')
    a = ap.parse_args()
    a.catoptric = a.catoptric or built()
    folder = os.path.join(ROOT, 'out', 'views')
    os.makedirs(folder, exist_ok=True)
    lines = []

    def say(text):
        print(text, flush=True)
        lines.append(text)
    say(f'# {machine()}: first and second views\n\n`python3 bench/views.py`: quality `{a.quality}`, wall and processor time of the whole program. *First*: `render SCENE`, of\n'
        'which *pass one* is all but reading, tracing the image and writing. *Second*: `render SCENE --solution FILE`, all included; *image*: its\n'
        f'share of pass two, what one more camera or frame of the same run costs. At 256, `yes` where second ≤ max({SHARE:.0%} of first, {SECONDS} s).')
    report = os.path.join(folder, 'report.json')
    for size in a.sizes:
        say(f'\n## {size}\n\n| scene | first, seconds (CPU) | pass one | MB | second, seconds (CPU) | image | MB | of first |' + (' within |' if size == '256' else ''))
        say('|---' * (9 if size == '256' else 8) + '|')
        for name in a.scenes:
            scene, solved = os.path.join(ROOT, 'scenes', name + '.glb'), os.path.join(folder, name + '.glb')
            view = ['-o', os.path.join(folder, f'{name}.exr'), '--size', size]
            first = measured(a, ['render', scene, *view, *sky(name)], report)
            if timed([a.catoptric, 'solve', scene, '-o', solved, '--quality', a.quality, '--quiet', *sky(name)], a.limit) is None or first is None:
                say(f'| {name} | more than {a.limit} |')
                continue
            # Where the sky is part of the solution it need not be named again.
            second = measured(a, ['render', scene, '--solution', solved, *view, *sky(name)], report)
            one = sum(s for stage, s in first['stages'].items() if stage not in ('load', 'image', 'write'))
            share = second['seconds'] / first['seconds']
            cells = [f'{first["seconds"]:.2f} ({first["cpu"]:.2f})', f'{one:.2f}', f'{first["mb"]:.0f}', f'{second["seconds"]:.2f} ({second["cpu"]:.2f})',
                     f'{second["stages"].get("image", 0):.2f}', f'{second["mb"]:.0f}', f'{share:.0%}']
            if size == '256':
                cells.append('yes' if second['seconds'] <= max(SHARE * first['seconds'], SECONDS) else 'no')
            say(f'| {name} | ' + ' | '.join(cells) + ' |')
    if a.out:
        with open(a.out, 'w') as f:
            f.write('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
