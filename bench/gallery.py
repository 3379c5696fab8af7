#!/usr/bin/env python3
"""Makes docs/gallery.md and its pictures: contacts and shadow edges four times enlarged, ours beside the reference and the difference.

    python3 bench/gallery.py                         # about two minutes; renders 256 pixels wide, as the references are
    python3 bench/gallery.py --quality high          # the same at another quality
    python3 bench/gallery.py --keep                  # from the images of the last run, in out/gallery

Python standard library only: `catoptric diff --pictures` makes the pictures, this enlarges them.
"""
import argparse, os, struct, subprocess, zlib

from measure import ROOT, built

ZOOM = 4
WIDTH, HEIGHT = 64, 48
# Scene: what is looked at, and the left upper corner of the crop in pixels of the reference.
CROPS = {
    'contacts': [('a box on the floor, and its shadow', 22, 104), ('a ring, a step, a box that leans', 72, 100), ('a partition between light and dark', 138, 140)],
    'cornell_box': [('the short block on the floor', 128, 200), ('its penumbra', 176, 192), ('the foot of the tall block', 54, 176)],
    'cornell_mirror': [('the mirror block on the floor', 54, 176), ('light thrown onto the ceiling', 34, 8), ('a block and its image', 96, 144)],
    'interior': [('legs and their shadows on a carpet', 74, 144), ('things on a table', 92, 84), ('books on shelves', 146, 60)],
    'mirror_light_shaft': [('a partition, lit from one side', 64, 44), ('a ball on the floor', 80, 170), ('a box in thrown light', 118, 178)],
    'two_mirrors': [('thrown light on the floor', 96, 110), ('a box on the floor', 44, 130), ('a ball on the floor', 120, 136)],
}
# Seen closer than the mesh: left, upper, right and lower edge in a picture of showcase CLOSE pixels wide.
CLOSE, EXPOSURE = 1024, '2.5'
CLOSE_CROPS = [('the shadows of two legs of the table', 200, 520, 400, 683), ('the shadow of a third, and a stool', 560, 480, 820, 683)]


def read_png(path):
    """-> width, height and rows of RGB bytes"""
    with open(path, 'rb') as f:
        data = f.read()
    at, packed = 8, b''
    while at < len(data):
        length, kind = struct.unpack('>I4s', data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        if kind == b'IHDR':
            width, height, depth, colour, _, _, interlaced = struct.unpack('>IIBBBBB', body)
            assert (depth, colour, interlaced) == (8, 2, 0), f'{path}: RGB of 8 bits expected'
        if kind == b'IDAT':
            packed += body
        at += 12 + length
    raw, stride, rows = zlib.decompress(packed), 3 * width, []
    above = bytearray(stride)
    for y in range(height):
        line = raw[y * (stride + 1):(y + 1) * (stride + 1)]
        row = bytearray(line[1:])
        for i in range(stride):
            left, up, corner = (row[i - 3], above[i], above[i - 3]) if i >= 3 else (0, above[i], 0)
            row[i] = (row[i] + [0, left, up, (left + up) // 2, paeth(left, up, corner)][line[0]]) & 255
        rows.append(bytes(row))
        above = row
    return width, height, rows


def paeth(a, b, c):
    p = a + b - c
    return min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]


def enlarged(rows, zoom):
    """each pixel as a square"""
    out = []
    for row in rows:
        pixels = [row[i:i + 3] for i in range(0, len(row), 3)]
        out += [b''.join(p * zoom for p in pixels)] * zoom
    return out


def write_png(path, rows):
    """Rows of RGB bytes; the filter Up makes repeated rows free."""
    above, raw = bytes(len(rows[0])), b''
    for row in rows:
        raw += b'\2' + bytes((a - b) & 255 for a, b in zip(row, above))
        above = row
    chunk = lambda kind, body: struct.pack('>I', len(body)) + kind + body + struct.pack('>I', zlib.crc32(kind + body))
    with open(path, 'wb') as f:
        f.write(b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', len(rows[0]) // 3, len(rows), 8, 2, 0, 0, 0))
                + chunk(b'IDAT', zlib.compress(raw, 9)) + chunk(b'IEND', b''))


def close_ups(program, folder, pictures, quality, keep):
    """a section of the page: light of lamps read from the mesh, and evaluated where a view is finer than it"""
    scene, solved = os.path.join(ROOT, 'scenes', 'showcase.glb'), os.path.join(folder, 'showcase.glb')
    rows = []
    for direct in 'vertices', 'auto':
        view = os.path.join(folder, f'showcase_{direct}.png')
        if not (keep and os.path.exists(view)):
            if not rows:
                subprocess.check_call([program, 'solve', scene, '-o', solved, '--quality', quality, '--quiet'])
            subprocess.check_call([program, 'render', scene, '--solution', solved, '--direct', direct, '-o', view, '--size', str(CLOSE), '--exposure', EXPOSURE, '--quality', quality, '--quiet'])
        rows.append(read_png(view)[2])
    page = ['', '## Closer than the mesh', '', f'showcase, {CLOSE} pixels wide, twice enlarged: left `--direct vertices`, right the default, `--direct auto`.']
    for number, (what, left, top, right, bottom) in enumerate(CLOSE_CROPS, 1):
        both = [a[3 * left:3 * right] + b'\xff' * 12 + b[3 * left:3 * right] for a, b in zip(rows[0][top:bottom], rows[1][top:bottom])]
        name = f'close_{number}.png'
        write_png(os.path.join(pictures, name), enlarged(both, 2))
        what = what[0].upper() + what[1:]
        page += ['', f'{what}:', '', f'![{what}: from the mesh, evaluated](images/gallery/{name})']
    return page


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('--quality', default='standard')
    ap.add_argument('--keep', action='store_true', help='do not render again')
    a = ap.parse_args()
    program = built()
    folder, pictures = os.path.join(ROOT, 'out', 'gallery'), os.path.join(ROOT, 'docs', 'images', 'gallery')
    os.makedirs(folder, exist_ok=True)
    os.makedirs(pictures, exist_ok=True)
    page = ['# Close-ups', '',
            f'Made by `python3 bench/gallery.py`: six scenes at `{a.quality}`, 256 pixels wide; contacts and shadow edges {ZOOM} times enlarged. Left',
            'ours, in the middle the path-traced reference with its noise, on the right FLIP between them, black where nobody sees a difference.']
    for scene, crops in CROPS.items():
        image, reference = os.path.join(folder, scene + '.exr'), os.path.join(ROOT, 'reference', scene + '.exr')
        if not (a.keep and os.path.exists(image)):
            subprocess.check_call([program, 'render', os.path.join(ROOT, 'scenes', scene + '.glb'), '-o', image, '--size', '256', '--quality', a.quality, '--quiet'])
        page += ['', f'## {scene}']
        for number, (what, x, y) in enumerate(crops, 1):
            made = os.path.join(folder, f'{scene}_{number}')
            # Its exit code says whether the crop is within the limits of the whole picture: not asked here.
            subprocess.run([program, 'diff', image, reference, '--crop', f'{x},{y},{WIDTH},{HEIGHT}', '--pictures', made, '--quiet'], stdout=subprocess.DEVNULL)
            _, _, rows = read_png(os.path.join(made, 'side-by-side.png'))
            name = f'{scene}_{number}.png'
            write_png(os.path.join(pictures, name), enlarged(rows, ZOOM))
            what = what[0].upper() + what[1:]
            page += ['', f'{what}:', '', f'![{what}: ours, reference, difference](images/gallery/{name})']
    page += close_ups(program, folder, pictures, a.quality, a.keep)
    with open(os.path.join(ROOT, 'docs', 'gallery.md'), 'w') as f:
        f.write('\n'.join(page) + '\n')
    sizes = [os.path.getsize(os.path.join(pictures, name)) for name in os.listdir(pictures)]
    print(f'docs/gallery.md: {len(sizes)} pictures, the largest {max(sizes) / 1e3:.0f} kB, together {sum(sizes) / 1e6:.2f} MB')


if __name__ == '__main__':
    main()
