#!/usr/bin/env python3
"""Traversal against Embree 4 on the same triangles and rays, on this machine, in one run.

    python3 bench/against_embree.py [--scenes cornell_box interior] [--width 1024] [--out out/bench]

Eye rays, and one cosine ray from each of their hits; single-ray queries (rtcIntersect1), one thread and all, the best of five runs.
Embree in robust mode (its fast mode is listed too), highest build quality. Prints a Markdown table and writes it to embree.md in --out.
Embree comes from the PyPI package embreex, in the environment out/bench-venv; needs a C compiler. Ours is compiled by
`cargo build --release`. Where the two find different nearest hits, by more than 1e-4 of the distance, is counted.
"""
import argparse, ctypes, datetime, glob, json, os, subprocess, sys, threading, time

from measure import in_venv

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)
PACKAGES = ['embreex==4.4.0.post1', 'numpy']
RUNS = 5
CHUNK = 4096


def load_embree(out):
    """Compiles the loop against the package's library."""
    import embreex
    site = os.path.dirname(os.path.dirname(embreex.__file__))
    found = sorted(glob.glob(os.path.join(site, 'embreex.libs', 'libembree4*')))
    if not found:
        sys.exit('embreex without a libembree4')
    folder, library = os.path.split(found[0])
    loop = os.path.join(out, 'embree_rays.so')
    subprocess.check_call(['cc', '-O3', '-shared', '-fPIC', os.path.join(HERE, 'embree_rays.c'), '-o', loop, f'-L{folder}', f'-l:{library}',
                           f'-Wl,-rpath,{folder}'])
    lib = ctypes.CDLL(loop)
    lib.make_scene.restype = ctypes.c_void_p
    lib.make_scene.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    lib.trace.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
    return lib


def best(run):
    times = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def embree_times(lib, scene, rays, threads):
    """-> seconds on one thread, on all, and the distances"""
    import numpy as np
    count = len(rays)
    hits = np.empty(count, np.float32)

    def part(first, last):
        lib.trace(scene, rays.ctypes.data + 24 * first, hits.ctypes.data + 4 * first, last - first)

    def all_threads():
        starts = iter(range(0, count, CHUNK))
        lock = threading.Lock()

        def work():
            while True:
                with lock:
                    first = next(starts, None)
                if first is None:
                    return
                part(first, min(first + CHUNK, count))

        workers = [threading.Thread(target=work) for _ in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()

    return best(lambda: part(0, count)), best(all_threads), hits


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('--scenes', nargs='+', default=['cornell_box', 'glass_sphere', 'interior', 'showcase'])
    ap.add_argument('--width', type=int, default=1024)
    ap.add_argument('--out', default=os.path.join(ROOT, 'out', 'bench'))
    ap.add_argument('--venv', default=os.path.join(ROOT, 'out', 'bench-venv'))
    ap.add_argument('--profile', default='release', help='of cargo, for trying things out')
    a = ap.parse_args()
    in_venv(a.venv, PACKAGES)
    import numpy as np
    a.out = os.path.abspath(a.out)
    os.makedirs(a.out, exist_ok=True)
    lib = load_embree(a.out)
    subprocess.check_call(['cargo', 'build', '--quiet', '--profile', a.profile, '-p', 'catoptric-benches', '--example', 'rays'], cwd=ROOT)
    target = os.environ.get('CARGO_TARGET_DIR', os.path.join(ROOT, 'target'))
    ours_program = os.path.join(target, a.profile, 'examples', 'rays')

    lines = [f'# {datetime.date.today().isoformat()}: traversal against Embree', '',
             f'`python3 bench/against_embree.py --scenes {" ".join(a.scenes)} --width {a.width}`, embreex {PACKAGES[0].split("=")[-1]}, '
             f'{os.cpu_count()} threads, load {os.getloadavg()[0]:.1f}. Million rays per second, the best of {RUNS} runs.', '',
             '| scene | triangles | rays | threads | ours | Embree robust | ours / robust | Embree fast | other hits |', '|---|---|---|---|---|---|---|---|---|']
    for name in a.scenes:
        done = subprocess.run([ours_program, os.path.join(ROOT, 'scenes', f'{name}.glb'), a.out, str(a.width)], stdout=subprocess.PIPE, check=True)
        ours = json.loads(done.stdout)
        corners = np.fromfile(os.path.join(a.out, 'triangles.f32'), np.float32)
        corners = np.append(corners, np.float32(0))      # Embree reads 16 bytes per corner
        indices = np.arange(3 * ours['triangles'], dtype=np.uint32)
        scenes = {robust: lib.make_scene(corners.ctypes.data, indices.ctypes.data, ours['triangles'], robust) for robust in (1, 0)}
        if not all(scenes.values()):
            sys.exit('Embree made no scene')
        for kind, own in ours['sets'].items():
            rays = np.fromfile(os.path.join(a.out, f'{kind}.rays.f32'), np.float32).reshape(-1, 6)
            hits = np.fromfile(os.path.join(a.out, f'{kind}.hits.f32'), np.float32)
            robust, fast = (embree_times(lib, scenes[mode], rays, ours['threads']) for mode in (1, 0))
            with np.errstate(invalid='ignore'):
                same = (hits == robust[2]) | (np.abs(hits - robust[2]) <= 1e-4 * np.abs(robust[2]))
            for k, threads in enumerate((1, ours['threads'])):
                rate = lambda seconds: len(rays) / seconds / 1e6
                mine, theirs = rate(own['all_threads' if k else 'one_thread']), rate(robust[k])
                lines.append(f'| {name} | {ours["triangles"]} | {kind}, {len(rays)} | {threads} | {mine:.2f} | {theirs:.2f} | '
                             f'{mine / theirs:.2f} | {rate(fast[k]):.2f} | {np.count_nonzero(~same)} |')
    for file in glob.glob(os.path.join(a.out, '*.f32')) + [os.path.join(a.out, 'embree_rays.so')]:
        os.remove(file)
    text = '\n'.join(lines) + '\n'
    with open(os.path.join(a.out, 'embree.md'), 'w') as f:
        f.write(text)
    print(text)


if __name__ == '__main__':
    main()
