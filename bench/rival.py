"""The rival of against_mitsuba.py: Mitsuba 3's `path`, alone and with Intel's Open Image Denoise. One process per scene.

    python bench/rival.py SCENE.glb --variant llvm_ad_rgb --seconds 60 --out FOLDER [--denoise] [--probe]

Prints one JSON object: what start-up, kernel compilation, loading and each sample count took, and the images it wrote. Scenes are
read by reference/make_reference.py; a scene with punctual lights or attenuation in glass is not the same scene in Mitsuba and is refused.
"""
import argparse, json, os, sys, time

COUNTS = [1, 4, 16, 64]     # samples per pixel of one render call; more are sums of calls of the last
HERE = os.path.dirname(os.path.abspath(__file__))


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('scene')
    ap.add_argument('--variant', default='llvm_ad_rgb')
    ap.add_argument('--seconds', type=float, default=30, help='of rendering; the last pass is completed')
    ap.add_argument('--width', type=int, default=256)
    ap.add_argument('--out', required=True)
    ap.add_argument('--denoise', action='store_true')
    ap.add_argument('--probe', action='store_true', help='only the time of 16 samples per pixel')
    a = ap.parse_args()

    begin = time.perf_counter()
    sys.path.insert(0, os.path.join(os.path.dirname(HERE), 'reference'))
    import numpy as np
    import make_reference as maker
    maker.start_mitsuba()                       # finds LLVM
    mi = maker.mi
    mi.set_variant(a.variant)
    startup = time.perf_counter() - begin

    begin = time.perf_counter()
    scene = maker.load_glb(a.scene)
    if scene['lights'] or any(m['material']['sigma'].any() for m in scene['meshes']):
        sys.exit(f'{scene["name"]}: Mitsuba\'s path tracer has no such lights or glass')
    world = maker.mitsuba_scene(scene, a.width)
    loading = time.perf_counter() - begin

    path = {'type': 'path', 'max_depth': -1, 'rr_depth': 5}
    seed = 0

    def shoot(integrator, count):
        """-> image, seconds"""
        nonlocal seed
        seed += 1
        begin = time.perf_counter()
        image = np.array(mi.render(world, integrator=integrator, spp=count, seed=seed), np.float32)
        return image, time.perf_counter() - begin

    def write(name, image):
        file = os.path.join(a.out, f'{scene["name"]}-{name}.exr')
        mi.Bitmap(np.ascontiguousarray(image[..., :3], np.float32)).write(file)
        return file

    # The first call of each kind compiles its kernel: what it takes longer than the second is compilation.
    compilation = 0.0

    def compile_first(integrator, counts):
        nonlocal compilation
        for count in counts:
            first, second = (shoot(integrator, count)[1] for _ in range(2))
            compilation += max(first - second, 0.0)

    os.makedirs(a.out, exist_ok=True)
    plain = mi.load_dict(path)
    compile_first(plain, [16] if a.probe else COUNTS[:3])
    if a.probe:
        print(json.dumps(dict(variant=a.variant, seconds=shoot(plain, 16)[1])))
        return

    # Single calls of few samples, then sums; images at each doubling.
    points, spent = [], 0.0
    for count in COUNTS:
        image, seconds = shoot(plain, count)
        spent += seconds
        points.append(dict(spp=count, seconds=seconds, file=write(f'path-{count}', image)))
    total, samples, seconds, due = image.astype(np.float64), COUNTS[-1], seconds, 2 * COUNTS[-1]
    while spent < a.seconds:
        image, more = shoot(plain, COUNTS[-1])
        total += image
        samples, seconds, spent = samples + COUNTS[-1], seconds + more, spent + more
        if samples == due or spent >= a.seconds:
            mean = total * (COUNTS[-1] / samples)
            points.append(dict(spp=samples, seconds=seconds, file=write(f'path-{samples}', mean)))
            due *= 2

    denoised, denoiser_startup = [], 0.0
    if a.denoise:
        import pyoidn
        guided = mi.load_dict({'type': 'aov', 'aovs': 'albedo:albedo,normal:sh_normal', 'path': path})
        compile_first(guided, [4])
        for count in COUNTS[1:]:
            image, seconds = shoot(guided, count)
            color, albedo, normal = (np.ascontiguousarray(image[..., k:k + 3]) for k in (0, image.shape[2] - 6, image.shape[2] - 3))
            run = lambda: pyoidn.denoise(color, albedo=albedo, normal=normal, hdr=True)
            if not denoised:
                begin = time.perf_counter()
                run()                           # loads the library and its weights
                denoiser_startup = time.perf_counter() - begin
            begin = time.perf_counter()
            clean = run()
            filtering = time.perf_counter() - begin
            denoised.append(dict(spp=count, seconds=seconds + filtering, filtering=filtering, file=write(f'denoised-{count}', clean)))
    print(json.dumps(dict(variant=a.variant, mitsuba=mi.__version__, startup=startup, loading=loading, compilation=compilation,
                          denoiser_startup=denoiser_startup, points=points, denoised=denoised)))


if __name__ == '__main__':
    main()
