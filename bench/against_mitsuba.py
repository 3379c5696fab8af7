#!/usr/bin/env python3
"""Error against time: Catoptric and Mitsuba 3 on the same scenes, on this machine, in one run.

    python3 bench/against_mitsuba.py                                        # six scenes, about 15 minutes
    python3 bench/against_mitsuba.py --minutes 3 --scenes cornell_box       # shorter
    python3 bench/against_mitsuba.py --out bench/runs/2026-11-21-mitsuba    # where a dated run is kept

Writes results.json, results.md (table, ratios of times at equal error) and relMSE.svg, FLIP.svg into --out, default out/bench. Makes its
own Python environment in out/bench-venv the first time. Needs Python 3.9 with venv, and for Mitsuba's faster variant an LLVM
library of version 17 or newer (Debian: libllvm19). Method: bench/README.md.
"""
import argparse, datetime, json, math, os, platform, shutil, subprocess, sys, tempfile, time

from measure import in_venv

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)
PACKAGES = ['mitsuba==3.9.1', 'numpy', 'matplotlib', 'pyoidn']
WIDTH = 256
SCENES = ['cornell_box', 'cornell_mirror', 'mirror_light_shaft', 'ring_caustic', 'glass_sphere', 'interior']
QUALITIES = ['sketch', 'draft', 'standard', 'high']
# Errors to which both are timed.
GOAL, GOALS = 1e-3, {'glass_sphere': 3e-3}
# Lit only by way of mirrors: the path tracer's single samples are so rare that only block means tell its error.
BLOCKS = {'mirror_light_shaft', 'two_mirrors', 'showcase'}
# Share of a scene's time for our runs; Mitsuba gets the rest.
OUR_SHARE = 0.4


def arguments():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('--scenes', nargs='+', default=SCENES, help='names of scenes/ that have a reference')
    ap.add_argument('--minutes', type=float, default=15, help='of the whole run, about')
    ap.add_argument('--repeats', type=int, default=3, help='runs of ours per quality; the median counts')
    ap.add_argument('--out', default=os.path.join(ROOT, 'out', 'bench'))
    ap.add_argument('--catoptric', help='the program; without it `cargo build --release` makes one')
    ap.add_argument('--venv', default=os.path.join(ROOT, 'out', 'bench-venv'))
    ap.add_argument('--plot-only', action='store_true', help='table and plots again from results.json')
    return ap.parse_args()


# -------------------------------------------------------------------------------------------------------------- measure

def timed(command):
    """-> wall seconds, CPU seconds and peak memory in MB of a process"""
    begin = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - begin
    if os.waitstatus_to_exitcode(status) != 0:
        sys.exit(f'failed: {" ".join(command)}')
    return dict(seconds=wall, cpu=usage.ru_utime + usage.ru_stime, mb=usage.ru_maxrss / 1024)


def judge(program, image, scene):
    """The numbers of `catoptric diff` against the scene's reference."""
    reference = os.path.join(ROOT, 'reference', f'{scene}.exr')
    done = subprocess.run([program, 'diff', image, reference, '--json'], stdout=subprocess.PIPE)
    if done.returncode not in (0, 1):       # 1: outside the limits
        sys.exit(f'{image}: not comparable')
    metrics = json.loads(done.stdout)['layers'][0]['metrics']
    return {k: metrics[k] for k in ('relMSE_nc', 'relMSE_b8', 'FLIP', 'lum_ratio') if k in metrics}


def ours(a, program, scene, budget):
    results, end = [], time.time() + budget
    for quality in QUALITIES:
        image = os.path.join(a.out, 'images', f'{scene}-{quality}.exr')
        command = [program, 'render', os.path.join(ROOT, 'scenes', f'{scene}.glb'), '-o', image, '--size', str(WIDTH), '--quiet',
                   '--quality', quality]
        # `high` may take eight times as long as `standard`.
        if quality == 'high' and 8 * results[-1]['seconds'] > end - time.time():
            print(f'  {quality} left out: no time', flush=True)
            break
        runs = []
        for _ in range(a.repeats):
            runs.append(timed(command))
            if time.time() + runs[-1]['seconds'] > end:
                break
        run = sorted(runs, key=lambda r: r['seconds'])[len(runs) // 2]
        results.append(dict(quality=quality, runs=len(runs), **run, **judge(program, image, scene)))
        print(f'  ours {quality}: {run["seconds"]:.2f} s', flush=True)
    return results


def rival(a, scene, *options):
    """One process of bench/rival.py. Its home is empty, so that no kernels of earlier runs are cached."""
    with tempfile.TemporaryDirectory() as home:
        command = [sys.executable, os.path.join(HERE, 'rival.py'), os.path.join(ROOT, 'scenes', f'{scene}.glb'), '--width', str(WIDTH),
                   '--out', os.path.join(a.out, 'images'), *options]
        done = subprocess.run(command, env=dict(os.environ, HOME=home), stdout=subprocess.PIPE)
    return json.loads(done.stdout) if done.returncode == 0 else None


def mitsuba(a, program, scene, budget):
    end = time.time() + budget
    probes = [p for p in (rival(a, scene, '--probe', '--variant', v) for v in ('llvm_ad_rgb', 'scalar_rgb')) if p]
    if not probes:
        return None
    probes.sort(key=lambda p: p['seconds'])
    # 4, 16 and 64 samples for the denoiser and those that the compiler is timed with: about ten times 16 samples.
    seconds = max(end - time.time() - 10 * probes[0]['seconds'], 1)
    result = rival(a, scene, '--variant', probes[0]['variant'], '--seconds', str(seconds), '--denoise')
    if result:
        result['probes'] = {p['variant']: p['seconds'] for p in probes}
        for point in result['points'] + result['denoised']:
            point.update(judge(program, point.pop('file'), scene))
        print(f'  Mitsuba {result["variant"]}: up to {result["points"][-1]["spp"]} samples per pixel', flush=True)
    return result


def machine():
    model = next((line.split(':')[1].strip() for line in open('/proc/cpuinfo') if line.startswith('model name')), platform.machine())
    return dict(cpu=model, threads=os.cpu_count(), load=os.getloadavg()[0], date=datetime.date.today().isoformat())


def run(a):
    program = a.catoptric
    if not program:
        subprocess.check_call(['cargo', 'build', '--release', '-p', 'catoptric'], cwd=ROOT)
        target = os.environ.get('CARGO_TARGET_DIR', os.path.join(ROOT, 'target'))
        program = os.path.join(target, 'release', 'catoptric')
    os.makedirs(os.path.join(a.out, 'images'), exist_ok=True)
    results = dict(machine=machine(), minutes=a.minutes, width=WIDTH, scenes={})
    begin = time.time()
    for index, scene in enumerate(a.scenes):
        # What is left is shared by the scenes that are left.
        budget = max(60 * a.minutes - (time.time() - begin), 1) / (len(a.scenes) - index)
        print(f'{scene}: {budget:.0f} s', flush=True)
        start = time.time()
        entry = dict(ours=ours(a, program, scene, OUR_SHARE * budget))
        entry['mitsuba'] = mitsuba(a, program, scene, budget - (time.time() - start))
        results['scenes'][scene] = entry
        with open(os.path.join(a.out, 'results.json'), 'w') as f:
            json.dump(results, f, indent=1)
    results['machine']['load_after'] = os.getloadavg()[0]
    with open(os.path.join(a.out, 'results.json'), 'w') as f:
        json.dump(results, f, indent=1)
    shutil.rmtree(os.path.join(a.out, 'images'))


# --------------------------------------------------------------------------------------------------------------- report

def measure_of(scene):
    return 'relMSE_b8' if scene in BLOCKS else 'relMSE_nc'


def rival_seconds(rival, key, goal):
    """Seconds (loading and rendering) until Mitsuba's error is `goal`; whether they are extrapolated. Squared error falls as
    1/time: beyond the last point it goes on from the last three. FLIP has no such law and is not extrapolated."""
    points = [(rival['loading'] + p['seconds'], p[key]) for p in rival['points'] if p.get(key, 0) > 0]
    if not points or goal <= 0:
        return None, False
    if points[0][1] <= goal:
        return points[0][0], False
    for (t0, e0), (t1, e1) in zip(points, points[1:]):
        if e1 <= goal < e0:
            share = math.log(e0 / goal) / math.log(e0 / e1)
            return t0 * (t1 / t0) ** share, False
    if key == 'FLIP':
        return None, True
    constant = sum(math.log(t * e) for t, e in points[-3:]) / len(points[-3:])
    return max(math.exp(constant) / goal, points[-1][0]), True


def our_seconds(results, key, goal):
    """Seconds until our error is `goal`: between two qualities in logarithms; those of the quickest where it is below."""
    points = [(o['seconds'], o[key]) for o in results if o.get(key, 0) > 0]
    if points and points[0][1] <= goal:
        return points[0][0]
    for (t0, e0), (t1, e1) in zip(points, points[1:]):
        if e1 <= goal < e0:
            return t0 * (t1 / t0) ** (math.log(e0 / goal) / math.log(e0 / e1))
    return None


def times(value, ours, extrapolated):
    if value is None:
        return '–', '–'
    mark = '*' if extrapolated else ''
    return f'{value:.3g}{mark}', f'{value / ours:.3g}{mark}'


def number(value):
    return '–' if value is None else f'{value:.3g}' if 1e-3 <= abs(value) < 1e4 else f'{value:.1e}'


def table(results):
    m = results['machine']
    lines = [f'# {m["date"]}: error against time, Mitsuba 3', '',
             f'`python3 bench/against_mitsuba.py --minutes {results["minutes"]:g} --scenes {" ".join(results["scenes"])}` on {m["cpu"]}, '
             f'{m["threads"]} threads, load {m["load"]:.1f} before the run' + (f' and {m["load_after"]:.1f} after it' if 'load_after' in m else '') + '. '
             f'{results["width"]} pixels wide. The method is that of [bench/README.md](README_LINK).', '',
             '## At equal error', '',
             'Seconds are wall time: of ours the whole program, of Mitsuba loading and rendering without start-up and kernel compilation. '
             'The measure is relMSE_nc, for scenes lit by way of mirrors alone relMSE_b8. * extrapolated as 1/time.', '',
             '| scene | quality | s | CPU s | MB | measure | error | Mitsuba s | ratio | FLIP | Mitsuba s | ratio |',
             '|---|---|---|---|---|---|---|---|---|---|---|---|']
    for scene, entry in results['scenes'].items():
        key = measure_of(scene)
        for o in entry['ours']:
            columns = []
            for k in (key, 'FLIP'):
                seconds, extrapolated = rival_seconds(entry['mitsuba'], k, o[k]) if entry['mitsuba'] else (None, False)
                columns += [number(o[k]), *times(seconds, o['seconds'], extrapolated)]
            lines.append(f'| {scene} | {o["quality"]} | {o["seconds"]:.2f} | {o["cpu"]:.2f} | {o["mb"]:.0f} | {key} | ' + ' | '.join(columns) + ' |')
    lines += ['', '## To a given error', '',
              'Ours lies between two qualities in logarithms, or is the quickest quality where that is better than the goal already.', '',
              '| scene | measure | goal | ours, s | Mitsuba s | ratio |', '|---|---|---|---|---|---|']
    for scene, entry in results['scenes'].items():
        key, goal = measure_of(scene), GOALS.get(scene, GOAL)
        own = our_seconds(entry['ours'], key, goal)
        seconds, extrapolated = rival_seconds(entry['mitsuba'], key, goal) if entry['mitsuba'] else (None, False)
        columns = times(seconds, own, extrapolated) if own else (times(seconds, 1, extrapolated)[0], '–')
        lines.append(f'| {scene} | {key} | {goal:g} | ' + (f'{own:.3f}' if own else '–') + ' | ' + ' | '.join(columns) + ' |')
    lines += ['', '## At equal time, with a denoiser', '',
              'Mitsuba `path` with albedo and normals, then Open Image Denoise (pyoidn): 4, 16 and 64 samples per pixel. Seconds are rendering and '
              'filtering; the first filter call takes longer by the start-up listed below.', '',
              '| scene | what | s | measure | error | FLIP | lum_ratio |', '|---|---|---|---|---|---|---|']
    for scene, entry in results['scenes'].items():
        key = measure_of(scene)
        rows = [(f'ours, {o["quality"]}', o) for o in entry['ours']]
        rows += [(f'{p["spp"]} samples + denoiser', p) for p in (entry['mitsuba'] or {}).get('denoised', [])]
        for what, p in rows:
            lines.append(f'| {scene} | {what} | {p["seconds"]:.2f} | {key} | {number(p.get(key))} | {number(p["FLIP"])} | {p["lum_ratio"]:.4f} |')
    lines += ['', '## What is not in these seconds', '',
              '| scene | variant | s of 16 samples, each variant | start-up s | kernel compilation s | loading s (included above) | denoiser start-up s |',
              '|---|---|---|---|---|---|---|']
    for scene, entry in results['scenes'].items():
        r = entry['mitsuba']
        if r:
            probes = ', '.join(f'{v} {s:.2f}' for v, s in r['probes'].items())
            lines.append(f'| {scene} | {r["variant"]} | {probes} | {r["startup"]:.2f} | {r["compilation"]:.2f} | {r["loading"]:.2f} | {r["denoiser_startup"]:.2f} |')
        else:
            lines.append(f'| {scene} | Mitsuba cannot render it | – | – | – | – | – |')
    lines += ['', '![relMSE against time](relMSE.svg)', '', '![FLIP against time](FLIP.svg)', '']
    return '\n'.join(lines)


def plot(results, out, which):
    import matplotlib
    matplotlib.use('svg')
    import matplotlib.pyplot as plt
    plt.rcParams.update({'svg.fonttype': 'none', 'svg.hashsalt': 'catoptric', 'font.size': 9, 'font.family': 'sans-serif'})
    scenes = results['scenes']
    columns = min(3, len(scenes))
    rows = math.ceil(len(scenes) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.6 * columns, 3.0 * rows + 0.5), squeeze=False, layout='constrained')
    for axis in axes.flat[len(scenes):]:
        axis.remove()
    for axis, (scene, entry) in zip(axes.flat, scenes.items()):
        key = measure_of(scene) if which == 'relMSE' else which
        rival = entry['mitsuba'] or dict(loading=0, points=[], denoised=[])

        def draw(points, **style):
            points = [(t, e) for t, e in points if e > 0]
            if points:
                axis.plot(*zip(*points), **style)

        draw([(rival['loading'] + p['seconds'], p.get(key, 0)) for p in rival['points']], color='#777777', marker='o', markersize=3,
             label='Mitsuba path')
        draw([(rival['loading'] + p['seconds'], p.get(key, 0)) for p in rival['denoised']], color='#2b6cb0', marker='s', markersize=4,
             linestyle='--', label='Mitsuba path + OIDN')
        draw([(o['seconds'], o.get(key, 0)) for o in entry['ours']], color='#c0392b', marker='D', markersize=5, label='Catoptric')
        for o in entry['ours']:
            if o.get(key, 0) > 0:
                axis.annotate(o['quality'], (o['seconds'], o[key]), textcoords='offset points', xytext=(5, 4), color='#c0392b', fontsize=8)
        axis.set(xscale='log', yscale='log', title=scene, xlabel='seconds', ylabel=key)
        axis.grid(True, which='major', color='#dddddd', linewidth=0.6)
        axis.set_axisbelow(True)
        axis.margins(x=0.15)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=3, frameon=False)
    figure.savefig(os.path.join(out, f'{which}.svg'), metadata={'Date': None})
    plt.close(figure)


def main():
    a = arguments()
    in_venv(a.venv, PACKAGES)
    a.out = os.path.abspath(a.out)
    os.makedirs(a.out, exist_ok=True)
    if not a.plot_only:
        run(a)
    with open(os.path.join(a.out, 'results.json')) as f:
        results = json.load(f)
    text = table(results)
    if os.path.realpath(a.out).startswith(os.path.realpath(ROOT) + os.sep):
        text = text.replace('README_LINK', os.path.relpath(os.path.join(HERE, 'README.md'), a.out))
    else:               # a link would name this machine's folders, and break elsewhere
        text = text.replace('[bench/README.md](README_LINK)', 'bench/README.md')
    with open(os.path.join(a.out, 'results.md'), 'w') as f:
        f.write(text)
    for which in ('relMSE', 'FLIP'):
        plot(results, a.out, which)
    print(text)


if __name__ == '__main__':
    main()
