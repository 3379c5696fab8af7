#!/usr/bin/env python3
"""Makes our own scenes: the same bytes every time, Python standard library only.

    python scenes/make_scenes.py               # all, beside this file
    python scenes/make_scenes.py pool contacts -o /tmp

The first half is a small layer of shapes and a .glb writer; each scene is one function in the second half.  Conventions
(materials, sides, units, camera) are those of README.md beside this file.
"""
import argparse, json, math, os, random, struct

# --------------------------------------------------------------------------------------------------------------- vectors

def add(a, b): return (a[0] + b[0], a[1] + b[1], a[2] + b[2])
def sub(a, b): return (a[0] - b[0], a[1] - b[1], a[2] - b[2])
def mul(a, k): return (a[0] * k, a[1] * k, a[2] * k)
def dot(a, b): return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
def cross(a, b): return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
def unit(a): return mul(a, 1 / math.sqrt(dot(a, a)))


def frame_towards(eye, target, up=(0, 1, 0)):
    """Columns x, y, z of the rotation that turns -z towards the target."""
    z = unit(sub(eye, target))
    x = unit(cross(up, z))
    return x, cross(z, x), z


def quaternion(x, y, z):
    """of the rotation with columns x, y, z"""
    t = x[0] + y[1] + z[2]
    if t > 0:
        s = 2 * math.sqrt(t + 1)
        q = ((y[2] - z[1]) / s, (z[0] - x[2]) / s, (x[1] - y[0]) / s, s / 4)
    elif x[0] > y[1] and x[0] > z[2]:
        s = 2 * math.sqrt(1 + x[0] - y[1] - z[2])
        q = (s / 4, (x[1] + y[0]) / s, (z[0] + x[2]) / s, (y[2] - z[1]) / s)
    elif y[1] > z[2]:
        s = 2 * math.sqrt(1 + y[1] - x[0] - z[2])
        q = ((x[1] + y[0]) / s, s / 4, (y[2] + z[1]) / s, (z[0] - x[2]) / s)
    else:
        s = 2 * math.sqrt(1 + z[2] - x[0] - y[1])
        q = ((z[0] + x[2]) / s, (y[2] + z[1]) / s, s / 4, (x[1] - y[0]) / s)
    return q


# ---------------------------------------------------------------------------------------------------------------- shapes

class Mesh:
    """Triangles with one normal per vertex; front = counter-clockwise = the side the normals are on."""

    def __init__(self):
        self.P, self.N, self.F = [], [], []

    def face(self, *points, towards=None):
        """A flat convex polygon; `towards` is a direction on its front side."""
        points = list(points)
        n = cross(sub(points[1], points[0]), sub(points[2], points[0]))
        if towards and dot(n, towards) < 0:
            points.reverse()
            n = mul(n, -1)
        first, n = len(self.P), unit(n)
        self.P += points
        self.N += [n] * len(points)
        self.F += [(first, first + i, first + i + 1) for i in range(1, len(points) - 1)]
        return self

    def smooth(self, points, normals, faces):
        """Smooth triangles, each turned to the side of its normals; degenerate ones dropped."""
        first = len(self.P)
        self.P += points
        self.N += normals
        for f in faces:
            a, b, c = (points[i] for i in f)
            g = cross(sub(b, a), sub(c, a))
            if dot(g, g) < 1e-20:
                continue
            side = dot(g, add(add(normals[f[0]], normals[f[1]]), normals[f[2]]))
            self.F.append(tuple(first + i for i in (f if side > 0 else f[::-1])))
        return self

    def merge(self, other):
        first = len(self.P)
        self.P += other.P
        self.N += other.N
        self.F += [(a + first, b + first, c + first) for a, b, c in other.F]
        return self

    def move(self, x=0, y=0, z=0):
        self.P = [add(p, (x, y, z)) for p in self.P]
        return self

    def turn(self, degrees, axis='y'):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        r = {'y': lambda p: (c * p[0] + s * p[2], p[1], c * p[2] - s * p[0]),
             'x': lambda p: (p[0], c * p[1] - s * p[2], s * p[1] + c * p[2]),
             'z': lambda p: (c * p[0] - s * p[1], s * p[0] + c * p[1], p[2])}[axis]
        self.P, self.N = [r(p) for p in self.P], [r(n) for n in self.N]
        return self

    def stretch(self, x=1, y=1, z=1):
        self.P = [(p[0] * x, p[1] * y, p[2] * z) for p in self.P]
        self.N = [unit((n[0] / x, n[1] / y, n[2] / z)) for n in self.N]
        return self

    def flip(self):
        self.N = [mul(n, -1) for n in self.N]
        self.F = [f[::-1] for f in self.F]
        return self


def quad(*points, towards=None):
    return Mesh().face(*points, towards=towards)


SIDES = {'left': (-1, 0, 0), 'right': (1, 0, 0), 'bottom': (0, -1, 0), 'top': (0, 1, 0), 'back': (0, 0, -1), 'front': (0, 0, 1)}


def side_of_box(lo, hi, side):
    n = SIDES[side]
    k = next(i for i in range(3) if n[i])
    i, j = (k + 1) % 3, (k + 2) % 3
    out = []
    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
        p = [0.0, 0.0, 0.0]
        p[k], p[i], p[j] = (hi if n[k] > 0 else lo)[k], (lo, hi)[a][i], (lo, hi)[b][j]
        out.append(tuple(p))
    return out


def box(lo, hi, without=()):
    m = Mesh()
    for s, n in SIDES.items():
        if s not in without:
            m.face(*side_of_box(lo, hi, s), towards=n)
    return m


def wall(lo, hi, side):
    """One side of a room, facing inwards."""
    return quad(*side_of_box(lo, hi, side), towards=mul(SIDES[side], -1))


def soft_box(lo, hi, bevel):
    """A box with chamfered edges."""
    c, h = mul(add(lo, hi), 0.5), mul(sub(hi, lo), 0.5)
    at = lambda s, k: add(c, tuple(s[i] * (h[i] - (0 if i == k else bevel)) for i in range(3)))
    signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    m = Mesh()
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        for s in (-1, 1):
            ring = []
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                v = [0, 0, 0]
                v[k], v[i], v[j] = s, a, b
                ring.append(at(v, k))
            m.face(*ring, towards=tuple(s if q == k else 0 for q in range(3)))
        for a in (-1, 1):
            for b in (-1, 1):
                v, w = [0, 0, 0], [0, 0, 0]
                v[i], v[j], v[k] = a, b, -1
                w[i], w[j], w[k] = a, b, 1
                m.face(at(v, i), at(w, i), at(w, j), at(v, j), towards=tuple(0 if q == k else v[q] for q in range(3)))
    for s in signs:
        m.face(at(s, 0), at(s, 1), at(s, 2), towards=s)
    return m


def ball(radius, levels):
    """A sphere of 20 * 4^levels triangles with the sphere's own normals."""
    t = (1 + math.sqrt(5)) / 2
    P = [unit(p) for p in [(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t), (0, -1, -t), (0, 1, -t),
                           (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1)]]
    F = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
         (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    for _ in range(levels):
        middle, G = {}, []

        def half(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(P)
                P.append(unit(add(P[a], P[b])))
            return middle[key]
        for a, b, c in F:
            ab, bc, ca = half(a, b), half(b, c), half(c, a)
            G += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        F = G
    return Mesh().smooth([mul(p, radius) for p in P], P, F)


def faceted(mesh):
    """The same triangles, each with its own flat normal."""
    m = Mesh()
    for f in mesh.F:
        m.face(*[mesh.P[i] for i in f])
    return m


def lathe(profiles, segments, closed=False):
    """Turns polylines of (radius, height) about the y axis; the front is to the right of the polyline's direction.
    Each polyline is smooth; start a new one for a crease.  `closed`: the one polyline is a loop (a torus)."""
    m = Mesh()
    for line in profiles:
        flat = [(b[1] - a[1], a[0] - b[0]) for a, b in zip(line, line[1:] + line[:1])]
        flat = [(x / math.hypot(x, y), y / math.hypot(x, y)) if x or y else (0, 0) for x, y in flat]
        n = len(line)
        P, N = [], []
        for i, (r, y) in enumerate(line):
            before = flat[i - 1] if i or closed else flat[0]
            after = flat[i] if i < n - 1 or closed else flat[n - 2]
            nx, ny = before[0] + after[0], before[1] + after[1]
            # a dome has one normal at its top, the tip of a cone those of its sides
            if r == 0 and abs(nx) < abs(ny):
                nx = 0
            for k in range(segments):
                c, s = math.cos(2 * math.pi * k / segments), math.sin(2 * math.pi * k / segments)
                P.append((r * c, y, r * s))
                N.append(unit((nx * c, ny, nx * s)))
        F = []
        for i in range(n if closed else n - 1):
            for k in range(segments):
                a, b = i * segments + k, i * segments + (k + 1) % segments
                c, d = (i + 1) % n * segments + k, (i + 1) % n * segments + (k + 1) % segments
                F += [(a, b, d), (a, d, c)]
        m.smooth(P, N, F)
    return m


def torus(radius, thickness, segments, around):
    loop = [(radius + thickness * math.cos(2 * math.pi * i / around), thickness * math.sin(2 * math.pi * i / around)) for i in range(around)]
    return lathe([loop], segments, closed=True)


def arc(cx, cy, r, a0, a1, n):
    """n + 1 points of a circle, degrees"""
    return [(max(cx + r * math.cos(math.radians(a0 + (a1 - a0) * i / n)), 0.0), cy + r * math.sin(math.radians(a0 + (a1 - a0) * i / n)))
            for i in range(n + 1)]


def cylinder(radius, y0, y1, segments):
    return lathe([[(0, y0), (radius, y0)], [(radius, y0), (radius, y1)], [(radius, y1), (0, y1)]], segments)


def band(radius_x, radius_z, height, segments, a0=0, a1=360):
    """An upright strip of no thickness, normals outwards."""
    whole = a1 - a0 >= 360
    P, N, F = [], [], []
    for k in range(segments + (0 if whole else 1)):
        a = math.radians(a0 + (a1 - a0) * k / segments)
        for y in (0, height):
            P.append((radius_x * math.cos(a), y, radius_z * math.sin(a)))
            N.append(unit((math.cos(a) / radius_x, 0, math.sin(a) / radius_z)))
    for k in range(segments):
        a, b = 2 * k, 2 * ((k + 1) % (len(P) // 2))
        F += [(a, b, b + 1), (a, b + 1, a + 1)]
    return Mesh().smooth(P, N, F)


def tube(points, radii, segments):
    """A round tube along a polyline, open at its ends."""
    n = len(points)
    radii = radii if isinstance(radii, list) else [radii] * n
    P, N, F = [], [], []
    side = None
    for i in range(n):
        t = unit(sub(points[min(i + 1, n - 1)], points[max(i - 1, 0)]))
        side = side or (1, 0, 0) if abs(t[0]) < 0.9 else side or (0, 1, 0)
        side = unit(sub(side, mul(t, dot(side, t))))
        other = cross(t, side)
        for k in range(segments):
            a = 2 * math.pi * k / segments
            normal = add(mul(side, math.cos(a)), mul(other, math.sin(a)))
            P.append(add(points[i], mul(normal, radii[i])))
            N.append(normal)
    for i in range(n - 1):
        for k in range(segments):
            a, b = i * segments + k, i * segments + (k + 1) % segments
            F += [(a, b, b + segments), (a, b + segments, a + segments)]
    return Mesh().smooth(P, N, F)


def prism(outline, y0, y1):
    """A convex outline of (x, z), extruded upwards, closed."""
    cx, cz = sum(p[0] for p in outline) / len(outline), sum(p[1] for p in outline) / len(outline)
    m = Mesh()
    m.face(*[(x, y1, z) for x, z in outline], towards=(0, 1, 0))
    m.face(*[(x, y0, z) for x, z in outline], towards=(0, -1, 0))
    for (ax, az), (bx, bz) in zip(outline, outline[1:] + outline[:1]):
        m.face((ax, y0, az), (bx, y0, bz), (bx, y1, bz), (ax, y1, az), towards=((ax + bx) / 2 - cx, 0, (az + bz) / 2 - cz))
    return m


def with_hole(lo, hi, hole_lo, hole_hi, place, towards):
    """A rectangle (u, v) with a rectangular hole, as four pieces; `place(u, v)` puts a point into the room."""
    (u0, v0), (u1, v1), (a0, b0), (a1, b1) = lo, hi, hole_lo, hole_hi
    m = Mesh()
    for p, q, r, s in ((u0, v0, a0, v1), (a1, v0, u1, v1), (a0, v0, a1, b0), (a0, b1, a1, v1)):
        if r > p and s > q:
            m.face(place(p, q), place(r, q), place(r, s), place(p, s), towards=towards)
    return m


# ------------------------------------------------------------------------------------------------------------- materials

def _plain(name, rgb, metallic, roughness, double, **extensions):
    m = {'name': name, 'doubleSided': double,
         'pbrMetallicRoughness': {'baseColorFactor': [*rgb, 1.0], 'metallicFactor': metallic, 'roughnessFactor': roughness}}
    if extensions:
        m['extensions'] = {'KHR_materials_' + k: v for k, v in extensions.items()}
    return m


def diffuse(name, rgb, double=False):
    return _plain(name, rgb, 0.0, 1.0, double, specular={'specularFactor': 0.0})


def mirror(name, rgb, double=False):
    return _plain(name, rgb, 1.0, 0.0, double)


def light(name, rgb, strength, reflectance=(0.0, 0.0, 0.0)):
    """Radiance rgb * strength, from the front."""
    m = _plain(name, reflectance, 0.0, 1.0, False, specular={'specularFactor': 0.0}, emissive_strength={'emissiveStrength': strength})
    m['emissiveFactor'] = list(rgb)
    return m


def glass(name, ior=1.5, attenuation=None, distance=None, rgb=(1.0, 1.0, 1.0)):
    volume = {'thicknessFactor': 1.0}
    if attenuation:
        volume.update(attenuationColor=list(attenuation), attenuationDistance=distance)
    return _plain(name, rgb, 0.0, 0.0, False, transmission={'transmissionFactor': 1.0}, volume=volume, ior={'ior': ior})


def pane(name, ior=1.5, rgb=(1.0, 1.0, 1.0)):
    return _plain(name, rgb, 0.0, 0.0, True, transmission={'transmissionFactor': 1.0}, ior={'ior': ior})


# ------------------------------------------------------------------------------------------------------------------ file

class Scene:
    def __init__(self, note):
        self.doc = {'asset': {'version': '2.0', 'generator': 'scenes/make_scenes.py', 'copyright': 'CC0-1.0', 'extras': {'note': note}},
                    'scene': 0, 'scenes': [{'nodes': []}], 'nodes': [], 'meshes': [], 'materials': [], 'accessors': [],
                    'bufferViews': [], 'buffers': []}
        self.blob = bytearray()
        self.triangles = 0

    def _accessor(self, kind, component, values, target, bounds=False):
        code = {5126: 'f', 5123: 'H', 5125: 'I'}[component]
        flat = [x for v in values for x in v] if kind == 'VEC3' else values
        data = struct.pack(f'<{len(flat)}{code}', *flat)
        self.blob += b'\0' * (-len(self.blob) % 4)
        self.doc['bufferViews'].append({'buffer': 0, 'byteOffset': len(self.blob), 'byteLength': len(data), 'target': target})
        self.blob += data
        a = {'bufferView': len(self.doc['bufferViews']) - 1, 'componentType': component, 'count': len(values), 'type': kind}
        if bounds:
            stored = list(struct.iter_unpack('<3f', data))
            a['min'], a['max'] = ([f(p[i] for p in stored) for i in range(3)] for f in (min, max))
        self.doc['accessors'].append(a)
        return len(self.doc['accessors']) - 1

    def _node(self, node, at, turn):
        if at:
            node['translation'] = list(at)
        if turn:
            node['rotation'] = [0.0, math.sin(math.radians(turn) / 2), 0.0, math.cos(math.radians(turn) / 2)]
        self.doc['nodes'].append(node)
        self.doc['scenes'][0]['nodes'].append(len(self.doc['nodes']) - 1)

    def put(self, name, material, *meshes, at=None, turn=0):
        """One object of one material; `turn` in degrees about y, then moved to `at`."""
        whole = Mesh()
        for m in meshes:
            whole.merge(m)
        if material not in self.doc['materials']:
            self.doc['materials'].append(material)
        small = len(whole.P) < 65536
        self.triangles += len(whole.F)
        self.doc['meshes'].append({'name': name, 'primitives': [{
            'attributes': {'POSITION': self._accessor('VEC3', 5126, whole.P, 34962, True), 'NORMAL': self._accessor('VEC3', 5126, whole.N, 34962)},
            'indices': self._accessor('SCALAR', 5123 if small else 5125, [i for f in whole.F for i in f], 34963),
            'material': self.doc['materials'].index(material), 'mode': 4}]})
        self._node({'name': name, 'mesh': len(self.doc['meshes']) - 1}, at, turn)

    def room(self, lo, hi, default, prefix='', **sides):
        """Six inward-facing walls; a side may have its own material, or None to be left out."""
        names = {'bottom': 'floor', 'top': 'ceiling', 'left': 'left_wall', 'right': 'right_wall', 'back': 'back_wall', 'front': 'front_wall'}
        for side, name in names.items():
            material = sides.get(side, default)
            if material:
                self.put(prefix + name, material, wall(lo, hi, side))

    def camera(self, eye, target, yfov, aspect=1.0):
        self.doc['cameras'] = [{'name': 'Camera', 'type': 'perspective', 'perspective': {
            'yfov': math.radians(yfov), 'aspectRatio': aspect, 'znear': 0.01, 'zfar': 1000.0}}]
        self.doc['nodes'].append({'name': 'Camera', 'camera': 0, 'translation': list(eye), 'rotation': list(quaternion(*frame_towards(eye, target)))})
        self.doc['scenes'][0]['nodes'].append(len(self.doc['nodes']) - 1)

    def spot(self, name, eye, target, candela, rgb, inner, outer):
        lights = self.doc.setdefault('extensions', {}).setdefault('KHR_lights_punctual', {'lights': []})['lights']
        lights.append({'name': name, 'type': 'spot', 'intensity': candela, 'color': list(rgb),
                       'spot': {'innerConeAngle': math.radians(inner), 'outerConeAngle': math.radians(outer)}})
        self.doc['nodes'].append({'name': name, 'translation': list(eye), 'rotation': list(quaternion(*frame_towards(eye, target))),
                                  'extensions': {'KHR_lights_punctual': {'light': len(lights) - 1}}})
        self.doc['scenes'][0]['nodes'].append(len(self.doc['nodes']) - 1)

    def write(self, path):
        used = sorted({e for m in self.doc['materials'] for e in m.get('extensions', {})} | set(self.doc.get('extensions', {})))
        doc = dict(self.doc, buffers=[{'byteLength': len(self.blob)}])
        if used:
            doc['extensionsUsed'] = used
        text = json.dumps(doc, separators=(',', ':')).encode()
        text += b' ' * (-len(text) % 4)
        data = bytes(self.blob) + b'\0' * (-len(self.blob) % 4)
        with open(path, 'wb') as f:
            f.write(struct.pack('<4sII', b'glTF', 2, 12 + 8 + len(text) + 8 + len(data)))
            f.write(struct.pack('<I4s', len(text), b'JSON') + text)
            f.write(struct.pack('<I4s', len(data), b'BIN\0') + data)


# ---------------------------------------------------------------------------------------------------------------- scenes

WHITE = diffuse('white', (0.75, 0.75, 0.75))
SCENES = {}


def scene(make):
    SCENES[make.__name__] = make
    return make


def framed(s, name, lo, hi, z, glass_material, frame_material, width=0.06, depth=0.04):
    """A flat framed rectangle on a wall that faces +z at height z: lo and hi are (x, y) of what the frame surrounds."""
    (x0, y0), (x1, y1) = lo, hi
    s.put(name, glass_material, quad((x0, y0, z + 0.5 * depth), (x1, y0, z + 0.5 * depth), (x1, y1, z + 0.5 * depth), (x0, y1, z + 0.5 * depth)))
    w = width
    s.put(name + '_frame', frame_material,
          box((x0 - w, y0 - w, z), (x1 + w, y0, z + depth), ('back',)), box((x0 - w, y1, z), (x1 + w, y1 + w, z + depth), ('back',)),
          box((x0 - w, y0, z), (x0, y1, z + depth), ('back', 'top', 'bottom')), box((x1, y0, z), (x1 + w, y1, z + depth), ('back', 'top', 'bottom')))


@scene
def spot_mirror():
    s = Scene('a spot light on a planar mirror lights the opposite wall; no other light')
    lo, hi = (-2, 0, -2), (2, 2.4, 2)
    s.room(lo, hi, diffuse('plaster', (0.72, 0.7, 0.66)), left=diffuse('blue', (0.25, 0.38, 0.6)), bottom=diffuse('floor', (0.5, 0.4, 0.32)))
    # the mirror stands turned in the right corner and throws the cone onto the left and back walls
    s.put('mirror_back', diffuse('backing', (0.3, 0.22, 0.16)), box((-0.56, 0.34, -0.06), (0.56, 1.96, -0.01)), at=(1.45, 0, -0.9), turn=-62)
    s.put('mirror', mirror('mirror', (0.95, 0.88, 0.75)), quad((-0.5, 0.4, 0), (0.5, 0.4, 0), (0.5, 1.9, 0), (-0.5, 1.9, 0)), at=(1.45, 0, -0.9), turn=-62)
    s.put('stand', diffuse('backing', (0.3, 0.22, 0.16)), box((-0.3, 0, -0.25), (0.3, 0.34, 0.05), ('bottom',)), at=(1.45, 0, -0.9), turn=-62)
    s.put('box', diffuse('ochre', (0.65, 0.48, 0.2)), box((-0.25, 0, -0.25), (0.25, 0.7, 0.25), ('bottom',)), at=(-0.75, 0, -1.1), turn=25)
    s.put('ball', WHITE, ball(0.25, 4), at=(-1.3, 0.25, -0.2))
    s.spot('spot', (0.2, 1.3, 1.7), (1.4, 1.15, -0.9), 40.0, (1.0, 0.9, 0.75), 9, 14)
    s.camera((0.6, 1.35, 1.85), (-0.35, 0.95, -1.2), 62, 1.25)
    return s


@scene
def bulb_in_glass():
    s = Scene('an emissive bulb in the cavity of a closed glass shell; every photon leaves through two refractions')
    s.room((-1.5, 0, -1.5), (1.5, 2.2, 1.6), diffuse('plaster', (0.72, 0.7, 0.68)), left=diffuse('rust', (0.62, 0.27, 0.17)), right=diffuse('sage', (0.35, 0.5, 0.38)),
           bottom=diffuse('floor', (0.45, 0.42, 0.4)))
    s.put('bulb', light('filament', (1.0, 0.82, 0.6), 40.0), ball(0.09, 4), at=(0.1, 1.15, -0.35))
    # solid between the spheres: the outer normals point out, the inner ones into the cavity
    s.put('shell', glass('glass'), ball(0.24, 4), ball(0.2, 4).flip(), at=(0.1, 1.15, -0.35))
    s.put('cord', diffuse('black', (0.04, 0.04, 0.04)), tube([(0, 1.392, 0), (0, 2.2, 0)], 0.008, 12), at=(0.1, 0, -0.35))
    s.put('box', diffuse('cream', (0.75, 0.7, 0.55)), box((-0.3, 0, -0.3), (0.3, 0.55, 0.3), ('bottom',)), at=(-0.7, 0, -0.8), turn=20)
    s.put('ball', diffuse('blue', (0.2, 0.35, 0.6)), ball(0.26, 4), at=(0.75, 0.26, -0.55))
    s.camera((0, 1.15, 1.55), (0, 0.95, -1), 62, 1.25)
    return s


@scene
def caustic_pane_mirror():
    s = Scene('the caustic of a glass ball, seen past, through a thin pane and in a planar mirror')
    lo, hi = (-1.3, 0, -1.4), (1.3, 1.9, 1.7)
    s.room(lo, hi, diffuse('plaster', (0.7, 0.69, 0.67)), left=diffuse('teal', (0.16, 0.42, 0.44)), right=diffuse('sand', (0.66, 0.52, 0.36)))
    s.put('light', light('light', (1.0, 0.92, 0.8), 45.0), quad((-0.2, 1.899, -0.75), (0.2, 1.899, -0.75), (0.2, 1.899, -0.35), (-0.2, 1.899, -0.35), towards=(0, -1, 0)))
    s.put('glass_ball', glass('glass'), ball(0.3, 5), at=(0.05, 0.72, -0.5))
    s.put('perch', diffuse('iron', (0.1, 0.1, 0.11)), torus(0.2, 0.015, 48, 12).move(y=0.485),
          *[tube([(0.2 * math.cos(a), 0.48, 0.2 * math.sin(a)), (0.36 * math.cos(a), 0, 0.36 * math.sin(a))], 0.012, 10) for a in (0.6, 2.7, 4.8)], at=(0.05, 0, -0.5))
    framed(s, 'mirror', (-0.95, 0.08), (0.95, 1.15), -1.4, mirror('mirror', (0.92, 0.92, 0.9)), diffuse('frame', (0.28, 0.17, 0.1)))
    # the pane's edge crosses the view of the caustic
    s.put('pane', pane('pane'), quad((-0.34, 0.03, 0), (0.34, 0.03, 0), (0.34, 0.8, 0), (-0.34, 0.8, 0)), at=(-0.3, 0, 0.36), turn=10)
    s.put('pane_frame', diffuse('frame', (0.28, 0.17, 0.1)), box((-0.36, 0, -0.03), (0.36, 0.03, 0.03), ('bottom',)), box((-0.36, 0.8, -0.01), (0.36, 0.82, 0.01)),
          box((-0.36, 0.03, -0.01), (-0.34, 0.8, 0.01), ('top', 'bottom')), box((0.34, 0.03, -0.01), (0.36, 0.8, 0.01), ('top', 'bottom')), at=(-0.3, 0, 0.36), turn=10)
    s.camera((0.0, 1.15, 1.62), (0.0, 0.42, -0.6), 52, 1.25)
    return s


@scene
def window_pane_room():
    s = Scene('a room lit only from an area light outside its window pane')
    wall_ = diffuse('plaster', (0.74, 0.72, 0.68))
    lo, hi = (-2, 0, -1.8), (2, 2.5, 1.8)
    s.room(lo, hi, wall_, left=None, back=diffuse('clay', (0.6, 0.36, 0.26)), bottom=diffuse('floor', (0.46, 0.34, 0.24)))
    z0, z1, y0, y1, deep = -0.9, 0.7, 0.85, 2.1, 0.25
    s.put('window_wall', wall_, with_hole((-1.8, 0), (1.8, 2.5), (z0, y0), (z1, y1), lambda u, v: (-2, v, u), (1, 0, 0)))
    s.put('reveal', diffuse('reveal', (0.8, 0.8, 0.78)),
          quad((-2 - deep, y0, z0), (-2, y0, z0), (-2, y0, z1), (-2 - deep, y0, z1), towards=(0, 1, 0)),
          quad((-2 - deep, y1, z0), (-2, y1, z0), (-2, y1, z1), (-2 - deep, y1, z1), towards=(0, -1, 0)),
          quad((-2 - deep, y0, z0), (-2, y0, z0), (-2, y1, z0), (-2 - deep, y1, z0), towards=(0, 0, 1)),
          quad((-2 - deep, y0, z1), (-2, y0, z1), (-2, y1, z1), (-2 - deep, y1, z1), towards=(0, 0, -1)))
    bars = [box((-2.2, y0, -0.13), (-2.15, y1, -0.07), ('top', 'bottom')), box((-2.2, 1.45, z0), (-2.15, 1.5, -0.13), ('back', 'front')),
            box((-2.2, 1.45, -0.07), (-2.15, 1.5, z1), ('back', 'front'))]
    s.put('bars', diffuse('bars', (0.7, 0.7, 0.7)), *bars)
    s.put('pane', pane('pane'), quad((-2.22, y0, z0), (-2.22, y0, z1), (-2.22, y1, z1), (-2.22, y1, z0)))
    # outside: a bright sheet, high enough that a patch of it falls on the floor
    s.put('light', light('sky', (0.85, 0.93, 1.0), 14.0), quad((-3.7, 1.3, -1.9), (-3.7, 1.3, 1.5), (-2.9, 3.3, 1.5), (-2.9, 3.3, -1.9), towards=(1, -0.5, 0)))
    s.put('sill', diffuse('bars', (0.7, 0.7, 0.7)), box((-2.0, 0.81, -0.95), (-1.85, 0.85, 0.75), ('left',)))
    s.put('table', diffuse('wood', (0.42, 0.26, 0.14)), soft_box((-0.6, 0.68, -0.4), (0.6, 0.72, 0.4), 0.006),
          *[box((x - 0.025, 0, z - 0.025), (x + 0.025, 0.68, z + 0.025), ('top', 'bottom')) for x in (-0.54, 0.54) for z in (-0.34, 0.34)], at=(-0.5, 0, -0.75), turn=8)
    s.put('bowl', diffuse('glaze', (0.2, 0.4, 0.55)), lathe([[(0, 0), (0.09, 0)], [(0.09, 0), (0.14, 0.03), (0.17, 0.08), (0.18, 0.12)], [(0.18, 0.12), (0.172, 0.12)],
          [(0.172, 0.12), (0.16, 0.08), (0.13, 0.035), (0.08, 0.012), (0, 0.01)]], 64), at=(-0.55, 0.72, -0.7))
    s.put('oranges', diffuse('orange', (0.75, 0.36, 0.06)), ball(0.06, 3).move(-0.05, 0.08, 0.02), ball(0.06, 3).move(0.06, 0.08, 0.04), ball(0.06, 3).move(0.0, 0.08, -0.07),
          at=(-0.55, 0.72, -0.7))
    s.put('chest', diffuse('chest', (0.3, 0.38, 0.33)), soft_box((-0.35, 0.0, -0.3), (0.35, 0.62, 0.3), 0.01), at=(1.15, 0.001, -1.35), turn=-12)
    s.camera((1.75, 1.45, 1.6), (-0.8, 0.95, -0.75), 58, 1.25)
    return s


@scene
def pool():
    s = Scene('a pool: the water is a closed glass body of ior 1.33 whose sides and bottom lie 2 cm behind the tiles')
    lo, hi = (-2.4, 0, -2.4), (2.4, 2.6, 2.4)
    s.room(lo, hi, diffuse('plaster', (0.76, 0.74, 0.7)), back=diffuse('ochre', (0.7, 0.5, 0.28)), bottom=None)
    x0, x1, z0, z1, depth, level = -1.5, 1.3, -1.7, 0.7, 0.9, -0.08
    s.put('deck', diffuse('stone', (0.62, 0.58, 0.52)), with_hole((-2.4, -2.4), (2.4, 2.4), (x0, z0), (x1, z1), lambda u, v: (u, 0, v), (0, 1, 0)))
    tiles = diffuse('tiles', (0.45, 0.68, 0.72))
    s.room((x0, -depth, z0), (x1, 0, z1), tiles, prefix='basin_', top=None, bottom=diffuse('basin_floor', (0.6, 0.75, 0.76)))
    s.put('stripes', diffuse('stripe', (0.12, 0.25, 0.45)), *[box((x - 0.09, -depth, z0 + 0.3), (x + 0.09, -depth + 0.004, z1 - 0.3), ('bottom',)) for x in (-0.95, -0.1, 0.75)])
    s.put('ball', diffuse('red', (0.7, 0.16, 0.1)), ball(0.16, 4), at=(0.35, -depth + 0.161, -0.9))
    s.put('steps', tiles, box((0.7, -depth, -0.1), (x1, -0.3, z1), ('bottom', 'right', 'front')), box((0.35, -depth, -0.1), (0.7, -0.6, z1), ('bottom', 'right', 'front')))
    # The water reaches 2 cm into the walls and the floor: rays meet the tiles first, no surface is shared and none is
    # missing, and the tiles below the level are receivers inside the medium.
    over, n = 0.02, 120
    waves = [(0.011, 7.1, 3.3, 0.4), (0.008, -4.2, 8.7, 1.9), (0.005, 12.5, -6.1, 4.0), (0.004, 3.0, 15.0, 2.2)]
    height = lambda x, z: level + sum(a * math.sin(kx * x + kz * z + f) for a, kx, kz, f in waves)
    slope = lambda x, z: unit((-sum(a * kx * math.cos(kx * x + kz * z + f) for a, kx, kz, f in waves), 1,
                               -sum(a * kz * math.cos(kx * x + kz * z + f) for a, kx, kz, f in waves)))
    grid = [(x0 - over + (x1 - x0 + 2 * over) * i / n, z0 - over + (z1 - z0 + 2 * over) * j / n) for j in range(n + 1) for i in range(n + 1)]
    at = lambda i, j: j * (n + 1) + i
    top = Mesh().smooth([(x, height(x, z), z) for x, z in grid], [slope(x, z) for x, z in grid],
                        [f for j in range(n) for i in range(n) for f in ((at(i, j), at(i + 1, j), at(i + 1, j + 1)), (at(i, j), at(i + 1, j + 1), at(i, j + 1)))])
    sides, bottom, low = Mesh(), Mesh(), -depth - over
    centre = ((x0 + x1) / 2, low, (z0 + z1) / 2)
    rim = [at(i, 0) for i in range(n + 1)] + [at(n, j) for j in range(1, n + 1)] + [at(i, n) for i in range(n - 1, -1, -1)] + [at(0, j) for j in range(n - 1, -1, -1)]
    for a, b in zip(rim, rim[1:]):
        (ax, az), (bx, bz) = grid[a], grid[b]
        sides.face((ax, height(ax, az), az), (bx, height(bx, bz), bz), (bx, low, bz), (ax, low, az), towards=(bz - az, 0, ax - bx))
        bottom.face(centre, (ax, low, az), (bx, low, bz), towards=(0, -1, 0))
    s.put('water', glass('water', 1.33, (0.72, 0.93, 0.95), 1.5), top, sides, bottom)
    s.put('light', light('light', (1.0, 0.95, 0.86), 22.0), quad((-0.9, 2.599, -1.1), (0.1, 2.599, -1.1), (0.1, 2.599, -0.3), (-0.9, 2.599, -0.3), towards=(0, -1, 0)))
    s.put('bench', diffuse('wood', (0.45, 0.28, 0.16)), soft_box((-0.7, 0.36, -0.15), (0.7, 0.42, 0.15), 0.008),
          *[box((x - 0.04, 0, -0.12), (x + 0.04, 0.36, 0.12), ('top', 'bottom')) for x in (-0.55, 0.55)], at=(-0.5, 0, -2.1))
    s.put('pot', diffuse('terracotta', (0.62, 0.3, 0.18)), lathe([[(0, 0), (0.14, 0)], [(0.14, 0), (0.2, 0.18), (0.22, 0.34)], [(0.22, 0.34), (0.19, 0.34)], [(0.19, 0.34), (0.18, 0.28)],
          [(0.18, 0.28), (0, 0.28)]], 48), at=(1.8, 0, -2.0))
    s.put('plant', diffuse('leaf', (0.15, 0.38, 0.14)), ball(0.26, 3).stretch(1, 1.15, 1).move(y=0.5), at=(1.8, 0, -2.0))
    s.camera((0.75, 1.6, 1.75), (-0.1, -0.4, -0.75), 54, 1.25)
    return s


@scene
def two_mirrors():
    s = Scene('a periscope: the lower room is lit only by way of two mirrors in sequence; the shaft is black velvet')
    velvet = diffuse('velvet', (0.02, 0.02, 0.02))
    # lower room with an opening in its back wall; shaft behind it; lamp chamber above the room
    lo, hi, w, a = (-1.5, 0, -1), (1.5, 2.0, 2.2), 0.45, 0.9
    s.room(lo, hi, diffuse('plaster', (0.75, 0.73, 0.7)), back=None, left=diffuse('rust', (0.65, 0.3, 0.2)), right=diffuse('blue', (0.2, 0.35, 0.6)))
    y0, y1 = 0.55, 0.55 + a
    s.put('back_wall', diffuse('plaster', (0.75, 0.73, 0.7)), with_hole((-1.5, 0), (1.5, 2.0), (-w, y0), (w, y1), lambda u, v: (u, v, -1), (0, 0, 1)))
    # shaft: x in [-w, w], z in [z0, z1] (5 cm behind the wall: no two surfaces share a plane back to back), from the opening's sill up to the lamp chamber's ceiling
    top, sill = 2.3, 2.3 + a
    z0, z1 = -1.05 - a, -1.05
    s.put('reveal', velvet, *[quad((x, y0, z1), (x, y0, -1), (x, y1, -1), (x, y1, z1), towards=(-x, 0, 0)) for x in (-w, w)],
          *[quad((-w, y, z1), (w, y, z1), (w, y, -1), (-w, y, -1), towards=(0, k, 0)) for y, k in ((y0, 1), (y1, -1))])
    s.put('shaft_sides', velvet, *[quad((x, y0, z0), (x, y0, z1), (x, sill, z1), (x, sill, z0), towards=(-x, 0, 0)) for x in (-w, w)],
          quad((-w, y1, z1), (w, y1, z1), (w, top, z1), (-w, top, z1), towards=(0, 0, -1)), quad((-w, y0, z0), (w, y0, z0), (w, sill, z0), (-w, sill, z0), towards=(0, 0, 1)))
    s.put('lower_mirror', mirror('silver', (0.92, 0.94, 0.96)), quad((-w, y0, z1), (w, y0, z1), (w, y1, z0), (-w, y1, z0), towards=(0, 1, 1)))
    s.put('upper_mirror', mirror('gold', (0.95, 0.78, 0.45)), quad((-w, sill, z1), (w, sill, z1), (w, top, z0), (-w, top, z0), towards=(0, -1, 1)))
    # lamp chamber: a black tube of the opening's size with the light at its end
    end = 0.2
    s.put('lamp_chamber', velvet, *[quad((x, top, z1), (x, top, end), (x, sill, end), (x, sill, z1), towards=(-x, 0, 0)) for x in (-w, w)],
          quad((-w, top, z1), (w, top, z1), (w, top, end), (-w, top, end), towards=(0, 1, 0)), quad((-w, sill, z1), (w, sill, z1), (w, sill, end), (-w, sill, end), towards=(0, -1, 0)))
    s.put('light', light('light', (1.0, 0.95, 0.88), 120.0), quad((-w, top, end), (w, top, end), (w, sill, end), (-w, sill, end), towards=(0, 0, -1)))
    s.put('box', diffuse('cream', (0.75, 0.68, 0.5)), box((-0.28, 0, -0.28), (0.28, 0.75, 0.28), ('bottom',)), at=(-0.55, 0, 0.35), turn=30)
    s.put('ball', WHITE, ball(0.3, 4), at=(0.55, 0.3, 0.3))
    s.camera((0.9, 1.5, 2.1), (-0.25, 0.75, -0.7), 66, 1.25)
    return s


@scene
def facing_mirrors():
    s = Scene('two mirrors face each other: endless reflections and endless images of the light')
    lo, hi = (-1.2, 0, -2), (1.2, 2.2, 2)
    s.room(lo, hi, diffuse('plaster', (0.72, 0.7, 0.68)), bottom=diffuse('floor', (0.5, 0.4, 0.3)), back=diffuse('green', (0.3, 0.5, 0.36)))
    frame = diffuse('frame', (0.2, 0.13, 0.08))
    for name, x, side, tint in (('left_mirror', -1.2, 1, (0.93, 0.9, 0.84)), ('right_mirror', 1.2, -1, (0.86, 0.92, 0.93))):
        p = x + side * 0.02
        s.put(name, mirror(name, tint), quad((p, 0.35, -1.4), (p, 0.35, 1.4), (p, 1.85, 1.4), (p, 1.85, -1.4), towards=(side, 0, 0)))
        a, b = sorted((x, x + side * 0.04))
        without = ('left',) if side > 0 else ('right',)
        s.put(name + '_frame', frame, box((a, 0.29, -1.46), (b, 0.35, 1.46), without), box((a, 1.85, -1.46), (b, 1.91, 1.46), without),
              box((a, 0.35, -1.46), (b, 1.85, -1.4), without + ('top', 'bottom')), box((a, 0.35, 1.4), (b, 1.85, 1.46), without + ('top', 'bottom')))
    s.put('light', light('light', (1.0, 0.93, 0.82), 20.0), quad((-0.25, 2.199, -0.7), (0.25, 2.199, -0.7), (0.25, 2.199, -0.2), (-0.25, 2.199, -0.2), towards=(0, -1, 0)))
    s.put('plinth', WHITE, box((-0.2, 0, -0.2), (0.2, 0.7, 0.2), ('bottom',)), at=(0.1, 0, -0.75), turn=20)
    s.put('ball', diffuse('red', (0.68, 0.2, 0.14)), ball(0.2, 4), at=(0.1, 0.901, -0.75))
    s.put('box', diffuse('blue', (0.2, 0.32, 0.6)), box((-0.22, 0, -0.22), (0.22, 0.4, 0.22), ('bottom',)), at=(-0.55, 0, -0.1), turn=-25)
    s.camera((0.75, 1.35, 1.75), (-0.35, 0.95, -0.6), 60, 1.25)
    return s


@scene
def mirror_corner():
    s = Scene('two mirrors at 90 degrees: both orders of reflection share one image, each side sees its own')
    lo, hi = (-1.6, 0, -1.6), (1.6, 2.2, 1.6)
    s.room(lo, hi, diffuse('plaster', (0.72, 0.7, 0.66)), right=diffuse('plum', (0.45, 0.2, 0.32)), bottom=diffuse('floor', (0.48, 0.46, 0.42)))
    # the mirrors meet in the vertical edge (-1.55, -1.55), a little off the room's corner
    c = -1.55
    s.put('mirror_x', mirror('silver', (0.94, 0.94, 0.94)), quad((c, 0.2, c), (c, 0.2, 0.3), (c, 1.7, 0.3), (c, 1.7, c), towards=(1, 0, 0)))
    s.put('mirror_z', mirror('rose', (0.95, 0.8, 0.72)), quad((c, 0.2, c), (0.3, 0.2, c), (0.3, 1.7, c), (c, 1.7, c), towards=(0, 0, 1)))
    frame = diffuse('frame', (0.16, 0.15, 0.15))
    s.put('frame', frame, box((-1.6, 0.1, -1.6), (c + 0.03, 0.2, 0.36), ('left', 'back')), box((c + 0.03, 0.1, -1.6), (0.36, 0.2, c + 0.03), ('left', 'back')),
          box((-1.6, 1.7, -1.6), (c + 0.03, 1.8, 0.36), ('left', 'back')), box((c + 0.03, 1.7, -1.6), (0.36, 1.8, c + 0.03), ('left', 'back')),
          box((-1.6, 0.2, 0.3), (c + 0.03, 1.7, 0.36), ('left', 'top', 'bottom')), box((0.3, 0.2, -1.6), (0.36, 1.7, c + 0.03), ('back', 'top', 'bottom')))
    s.put('light', light('light', (1.0, 0.92, 0.8), 18.0), quad((0.1, 2.199, -0.9), (0.6, 2.199, -0.9), (0.6, 2.199, -0.4), (0.1, 2.199, -0.4), towards=(0, -1, 0)))
    s.put('cone', diffuse('ochre', (0.72, 0.5, 0.18)), lathe([[(0.3, 0), (0.0, 0.9)]], 64), at=(-0.75, 0, -0.65))
    s.put('box', diffuse('blue', (0.18, 0.34, 0.6)), box((-0.2, 0, -0.2), (0.2, 0.5, 0.2), ('bottom',)), at=(0.35, 0, -0.95), turn=35)
    s.put('ball', WHITE, ball(0.22, 4), at=(-1.0, 0.221, 0.35))
    s.camera((1.3, 1.45, 1.45), (-0.8, 0.75, -0.85), 56, 1.25)
    return s


def furnace(s):
    """Walls that emit (1, 0.5, 0.25) and reflect 0.5: every ray that ends on a wall brings (2, 1, 0.5).  The balls inside are
    faceted: with interpolated normals a direction can point below its facet, and what becomes of it is a convention."""
    s.room((-1, -1, -1), (1, 1, 1), light('furnace', (1.0, 0.5, 0.25), 1.0, (0.5, 0.5, 0.5)))
    s.camera((0.35, 0.3, 0.95), (0, -0.1, 0), 62)


@scene
def glass_furnace():
    s = Scene('a closed uniform furnace with lossless glass inside, which must vanish')
    furnace(s)
    s.put('glass_ball', glass('glass', 1.5), faceted(ball(0.4, 3)), at=(-0.35, -0.1, -0.1))
    s.put('glass_cube', glass('dense_glass', 1.7), box((-0.22, -0.22, -0.22), (0.22, 0.22, 0.22)), at=(0.42, -0.35, -0.25), turn=27)
    return s


@scene
def mirror_furnace():
    s = Scene('a closed uniform furnace with lossless mirrors inside, which must vanish')
    furnace(s)
    one = mirror('lossless', (1.0, 1.0, 1.0))
    s.put('mirror_ball', one, faceted(ball(0.38, 3)), at=(-0.38, -0.1, -0.1))
    s.put('mirror_box', one, box((-0.22, -0.3, -0.22), (0.22, 0.3, 0.22)), at=(0.42, -0.3, -0.3), turn=27)
    s.put('mirror_sheet', mirror('lossless_sheet', (1.0, 1.0, 1.0), True), quad((-0.2, 0.45, -0.5), (0.3, 0.5, -0.4), (0.3, 0.8, -0.6), (-0.2, 0.75, -0.7)))
    return s


@scene
def sky_body():
    s = Scene('a convex diffuse body and no light: for a uniform sky L, where H = pi L on every face')
    # an eight-sided prism with cut edges, every side of another colour; flat normals
    outline = [(0.6 * math.cos(math.pi / 4 * (k + 0.5)), 0.6 * math.sin(math.pi / 4 * (k + 0.5))) for k in range(8)]
    inner = [(0.72 * x, 0.72 * z) for x, z in outline]
    palette = [(0.8, 0.75, 0.65), (0.62, 0.25, 0.18), (0.2, 0.35, 0.6), (0.7, 0.55, 0.15), (0.3, 0.5, 0.35), (0.5, 0.5, 0.5), (0.85, 0.85, 0.85), (0.1, 0.1, 0.12)]
    for k in range(8):
        (ax, az), (bx, bz) = outline[k], outline[(k + 1) % 8]
        (cx, cz), (dx, dz) = inner[k], inner[(k + 1) % 8]
        out = ((ax + bx) / 2, 0, (az + bz) / 2)
        s.put(f'side_{k}', diffuse(f'side_{k}', palette[k]),
              quad((ax, -0.45, az), (bx, -0.45, bz), (bx, 0.45, bz), (ax, 0.45, az), towards=out),
              quad((ax, 0.45, az), (bx, 0.45, bz), (dx, 0.7, dz), (cx, 0.7, cz), towards=(out[0], 1, out[2])),
              quad((ax, -0.45, az), (bx, -0.45, bz), (dx, -0.7, dz), (cx, -0.7, cz), towards=(out[0], -1, out[2])))
    s.put('top', diffuse('top', (0.75, 0.75, 0.75)), quad(*[(x, 0.7, z) for x, z in inner], towards=(0, 1, 0)))
    s.put('bottom', diffuse('bottom', (0.75, 0.75, 0.75)), quad(*[(x, -0.7, z) for x, z in inner], towards=(0, -1, 0)))
    s.camera((1.3, 1.2, 2.0), (0, 0, 0), 42)
    return s


@scene
def contacts():
    s = Scene('surfaces that touch and cross: where light and shadow leak')
    lo, hi = (-2, 0, -1.8), (2, 2.2, 2)
    plaster = diffuse('plaster', (0.74, 0.72, 0.69))
    s.room(lo, hi, plaster, back=None, left=diffuse('rust', (0.6, 0.28, 0.2)), right=diffuse('blue', (0.22, 0.36, 0.6)))
    # one picture lies in the wall's own plane, in a hole of exactly its size; the other hangs 2 mm in front of it
    s.put('back_wall', plaster, with_hole((-2, 0), (0.6, 2.2), (-1.5, 1.1), (-0.7, 1.7), lambda u, v: (u, v, -1.8), (0, 0, 1)),
          quad((0.6, 0, -1.8), (2, 0, -1.8), (2, 2.2, -1.8), (0.6, 2.2, -1.8), towards=(0, 0, 1)))
    s.put('picture_in_plane', diffuse('ochre', (0.7, 0.5, 0.15)), quad((-1.5, 1.1, -1.8), (-0.7, 1.1, -1.8), (-0.7, 1.7, -1.8), (-1.5, 1.7, -1.8), towards=(0, 0, 1)))
    s.put('picture_2mm', diffuse('green', (0.2, 0.45, 0.28)), quad((-0.45, 1.1, -1.798), (0.25, 1.1, -1.798), (0.25, 1.7, -1.798), (-0.45, 1.7, -1.798), towards=(0, 0, 1)))
    # the partition runs through floor, ceiling and back wall; behind it there is only what comes round its open end
    s.put('partition', diffuse('partition', (0.7, 0.66, 0.55)), box((0.6, -0.1, -1.9), (0.64, 2.3, 0.2)))
    # a zero-thickness band on the floor, lit from one side
    s.put('band', diffuse('band', (0.66, 0.66, 0.7), True), band(0.4, 0.4, 0.28, 48, 20, 250), at=(-0.15, 0, 0.2))
    s.put('box_on_floor', diffuse('cream', (0.76, 0.7, 0.52)), box((-0.25, 0, -0.25), (0.25, 0.5, 0.25)), at=(-1.35, 0, -0.2), turn=18)
    s.put('sheet_on_floor', diffuse('teal', (0.16, 0.42, 0.42)), box((-0.3, 0, -0.2), (0.3, 0.01, 0.2)), at=(-1.3, 0, 0.75), turn=-15)
    s.put('crossing_a', diffuse('plum', (0.5, 0.22, 0.36)), box((-0.45, -0.05, -0.12), (0.45, 0.6, 0.12)), at=(-0.55, 0, -1.0), turn=20)
    s.put('crossing_b', diffuse('sage', (0.42, 0.55, 0.42)), box((-0.12, 0, -0.4), (0.12, 0.35, 0.4)), at=(-0.5, 0, -0.95), turn=-5)
    s.put('stack_low', diffuse('grey', (0.5, 0.5, 0.5)), box((-0.2, 0, -0.2), (0.2, 0.3, 0.2)), at=(1.3, 0, -0.9), turn=10)
    s.put('stack_high', diffuse('cream', (0.76, 0.7, 0.52)), box((-0.15, 0.3, -0.15), (0.15, 0.6, 0.15)), at=(1.3, 0, -0.9), turn=40)
    s.put('light', light('light', (1.0, 0.93, 0.82), 20.0), quad((-1.1, 2.199, -0.8), (-0.6, 2.199, -0.8), (-0.6, 2.199, -0.3), (-1.1, 2.199, -0.3), towards=(0, -1, 0)))
    s.camera((0.55, 1.5, 1.95), (-0.12, 0.65, -1.0), 68, 1.25)
    return s


def books(rng, length, depth, height):
    """A row of books along x, spines at z = 0, lying against z = -depth; -> {colour index: Mesh}"""
    out, x = {}, 0.0
    while x < length - 0.05:
        w, h, d = rng.uniform(0.018, 0.045), height * rng.uniform(0.72, 0.97), depth * rng.uniform(0.75, 0.95)
        lean = rng.random() < 0.07
        b = soft_box((0, 0, -d), (w, h, 0), 0.003)
        if lean:
            b.turn(-9, 'z').move(y=0.004)
            w += 0.15 * h
        out.setdefault(rng.randrange(6), Mesh()).merge(b.move(x=x, z=-rng.uniform(0.0, 0.012)))
        x += w + 0.002
    return out


@scene
def showcase():
    s = Scene('the hall right of the partition is lit only by way of the gold mirror: the window can be seen in the mirror alone')
    rng = random.Random(7)
    plaster, trim = diffuse('plaster', (0.8, 0.77, 0.72)), diffuse('trim', (0.8, 0.78, 0.74))
    walnut, oak, black = diffuse('walnut', (0.26, 0.15, 0.085)), diffuse('oak', (0.48, 0.31, 0.17)), diffuse('black', (0.035, 0.035, 0.04))
    teal = diffuse('teal', (0.06, 0.24, 0.27))
    lo, hi = (-4.3, 0, -3), (2.5, 3.0, 3.4)
    s.room(lo, hi, plaster, bottom=None, right=diffuse('sage', (0.33, 0.43, 0.39)))

    # floor boards of four tones
    tones = [Mesh() for _ in range(4)]
    for row in range(32):
        z = -3 + 0.2 * row
        x = -4.3 - rng.uniform(0, 1.6)
        while x < 2.5:
            e = x + rng.uniform(1.3, 2.1)
            tones[rng.randrange(4)].merge(quad((max(x, -4.3), 0, z), (min(e, 2.5), 0, z), (min(e, 2.5), 0, z + 0.2), (max(x, -4.3), 0, z + 0.2), towards=(0, 1, 0)))
            x = e
    for k, m in enumerate(tones):
        s.put(f'floor_{k}', diffuse(f'board_{k}', ((0.36, 0.24, 0.15), (0.40, 0.27, 0.17), (0.33, 0.215, 0.13), (0.38, 0.25, 0.15))[k]), m)

    # the partition: left of it the window, right of it the hall
    px, pe = -1.75, -1.25
    s.put('partition', plaster, box((px - 0.12, 0, pe), (px, 3.0, 3.4), ('top', 'bottom', 'front')))
    h, d = 0.11, 0.016
    s.put('skirting', trim, box((-1.65, 0, -3), (2.5, h, -3 + d), ('back', 'bottom', 'left')), box((2.5 - d, 0, -3 + d), (2.5, h, 3.4), ('right', 'bottom', 'back')),
          box((px, 0, pe - d), (px + d, h, 3.4), ('left', 'bottom')), box((px - 0.12, 0, pe - d), (px, h, pe), ('front', 'bottom', 'right')),
          box((-4.3, 0, -3), (-1.85, h, -3 + d), ('back', 'bottom', 'right')))
    s.put('cornice', trim, box((-4.3, 2.91, -3), (2.5, 3.0, -2.94), ('back', 'top')), box((2.44, 2.91, -2.94), (2.5, 3.0, 3.4), ('right', 'top', 'back')),
          box((px, 2.91, pe), (px + 0.06, 3.0, 3.4), ('left', 'top')))

    # the window: a bright sheet behind glazing bars, facing the back wall
    wx0, wx1, wy0, wy1, wz = -3.95, -2.55, 0.6, 2.1, -0.35
    s.put('window', light('daylight', (0.7, 0.86, 1.0), 8.0), quad((wx0, wy0, wz), (wx1, wy0, wz), (wx1, wy1, wz), (wx0, wy1, wz), towards=(0, 0, -1)))
    bars = [box((wx0 + (wx1 - wx0) * k / 3 - 0.02, wy0, wz - 0.06), (wx0 + (wx1 - wx0) * k / 3 + 0.02, wy1, wz - 0.02)) for k in range(4)]
    bars += [box((wx0, y - 0.02, wz - 0.055), (wx1, y + 0.02, wz - 0.025)) for y in (wy0, (wy0 + wy1) / 2 + 0.2, wy1)]
    s.put('window_bars', trim, *bars)
    s.put('window_wall', plaster, with_hole((-4.3, 0), (px - 0.12, 3.0), (wx0, wy0), (wx1, wy1), lambda u, v: (u, v, wz), (0, 0, -1)))

    # a lamp above the window, shaded so that it shines on the mirror alone
    lamp = (-2.65, 2.62, -0.62)
    axes = frame_towards(lamp, (-1.1, 1.5, -3))
    place = lambda u, v, w: add(lamp, add(add(mul(axes[0], u), mul(axes[1], v)), mul(axes[2], -w)))
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    s.put('lamp', light('lamp', (1.0, 0.93, 0.82), 620.0), quad(*[place(0.2 * u, 0.2 * v, 0.01) for u, v in corners], towards=mul(axes[2], -1)))
    s.put('lamp_shade', diffuse('shade', (0.03, 0.03, 0.035), True), *[quad(place(0.21 * a, 0.21 * b, 0), place(0.21 * c, 0.21 * d, 0), place(0.23 * c, 0.23 * d, 1.0), place(0.23 * a, 0.23 * b, 1.0))
          for (a, b), (c, d) in zip(corners, corners[1:] + corners[:1])], quad(*[place(0.21 * u, 0.21 * v, 0) for u, v in corners]))
    s.put('alcove_panel', diffuse('navy', (0.05, 0.075, 0.105)), box((-4.3, 0.11, -3), (-1.7, 3.0, -2.99), ('back', 'top', 'left')))

    # the gold mirror in its frame
    mx0, mx1, my0, my1 = -1.6, 0.5, 0.62, 2.32
    gold, gilt = mirror('gold_mirror', (0.98, 0.80, 0.50)), diffuse('gilt', (0.50, 0.33, 0.13))
    framed(s, 'mirror', (mx0, my0), (mx1, my1), -3, gold, gilt, 0.045, 0.03)
    framed_outer = ((mx0 - 0.045, my0 - 0.045), (mx1 + 0.045, my1 + 0.045))
    (ax, ay), (bx, by) = framed_outer
    s.put('mirror_moulding', walnut, box((ax - 0.05, ay - 0.05, -3), (bx + 0.05, ay, -2.95), ('back',)), box((ax - 0.05, by, -3), (bx + 0.05, by + 0.05, -2.95), ('back',)),
          box((ax - 0.05, ay, -3), (ax, by, -2.95), ('back', 'top', 'bottom')), box((bx, ay, -3), (bx + 0.05, by, -2.95), ('back', 'top', 'bottom')))

    # a convex mirror in a round frame
    R, a = 0.62, 30
    cap = [(R * math.sin(math.radians(t)), R * math.cos(math.radians(t)) - R * math.cos(math.radians(a))) for t in [a * (1 - i / 16) for i in range(17)]]
    cap[-1] = (0.0, cap[-1][1])
    s.put('convex_mirror', mirror('silver', (0.93, 0.93, 0.92)), lathe([cap], 96).turn(90, 'x'), at=(1.45, 1.62, -2.985))
    s.put('convex_frame', gilt, torus(0.325, 0.028, 72, 16).turn(90, 'x'), at=(1.45, 1.62, -2.985))

    # rug and low table
    s.put('rug', teal, box((-1.25, 0, -1.05), (1.25, 0.012, 0.85), ('bottom',)), at=(0.3, 0, -0.45), turn=4)
    s.put('rug_border', diffuse('rug_border', (0.52, 0.44, 0.3)), *[box(a, b, ('bottom',)) for a, b in (
        ((-1.17, 0.012, -0.97), (1.17, 0.0135, -0.93)), ((-1.17, 0.012, 0.73), (1.17, 0.0135, 0.77)),
        ((-1.17, 0.012, -0.93), (-1.13, 0.0135, 0.73)), ((1.13, 0.012, -0.93), (1.17, 0.0135, 0.73)))], at=(0.3, 0, -0.45), turn=4)
    ty = 0.46
    legs = [tube([(x, 0.012, z), (x * 0.93, ty - 0.045, z * 0.9)], [0.014, 0.024], 16) for x in (-0.66, 0.66) for z in (-0.36, 0.36)]
    s.put('table', diffuse('ash', (0.58, 0.44, 0.29)), soft_box((-0.75, ty - 0.045, -0.44), (0.75, ty, 0.44), 0.008), *legs, at=(0.35, 0, -0.45), turn=4)

    # on the table: glass ball, mirror ring, solid glass vase, books, fruit
    table = lambda x, z, y=0.0: (0.35 + x, ty + y, -0.45 + z)
    s.put('glass_ball', glass('glass', 1.5), ball(0.17, 5), at=table(-0.4, 0.08, 0.1701))
    s.put('mirror_ring', mirror('brass', (0.95, 0.82, 0.55), True), band(0.15, 0.15, 0.075, 192), at=table(0.06, 0.18))
    s.put('glass_prism', glass('prism', 1.6), prism([(0.09 * math.cos(math.pi / 3 * k), 0.09 * math.sin(math.pi / 3 * k)) for k in range(6)], 0.0, 0.36), at=table(0.03, -0.24, 0.0005), turn=12)
    s.put('book_red', diffuse('book_red', (0.5, 0.1, 0.07)), soft_box((-0.14, 0, -0.1), (0.14, 0.032, 0.1), 0.003), at=table(0.5, -0.08), turn=24)
    s.put('book_cream', diffuse('book_cream', (0.68, 0.6, 0.44)), soft_box((-0.12, 0, -0.09), (0.12, 0.026, 0.09), 0.003), at=table(0.5, -0.08, 0.0325), turn=8)
    s.put('chrome_ball', mirror('silver', (0.93, 0.93, 0.92)), ball(0.09, 4), at=table(0.5, -0.08, 0.1492))

    # bookcase along the right wall
    x0, x1, z0, z1, hh = 2.17, 2.49, -1.75, -0.35, 1.62
    shelves = [0.09 + 0.375 * k for k in range(5)]      # the last one is the top
    hh = shelves[-1]
    s.put('bookcase', oak, box((x0, 0, z0), (x1, hh, z0 + 0.03), ('bottom',)), box((x0, 0, z1 - 0.03), (x1, hh, z1), ('bottom',)),
          *[box((x0, y - 0.025, z0 + 0.03), (x1, y, z1 - 0.03), ('back', 'front')) for y in shelves], box((x1 - 0.01, 0.0, z0 + 0.03), (x1, hh, z1 - 0.03), ('bottom',)))
    colours = [(0.45, 0.1, 0.08), (0.1, 0.22, 0.35), (0.62, 0.52, 0.35), (0.13, 0.3, 0.2), (0.58, 0.34, 0.1), (0.3, 0.13, 0.2)]
    spines = {}
    for y in shelves[:-1]:
        for k, m in books(rng, z1 - z0 - 0.07, 0.24, 0.33).items():
            spines.setdefault(k, Mesh()).merge(m.turn(-90).move(x0 + 0.03, y, z0 + 0.035))
    for k, m in sorted(spines.items()):
        s.put(f'books_{k}', diffuse(f'spine_{k}', colours[k]), m)
    s.put('bowl', diffuse('glaze', (0.12, 0.3, 0.38)), lathe([[(0, 0), (0.06, 0)], [(0.06, 0), (0.11, 0.03), (0.14, 0.08), (0.15, 0.12)], [(0.15, 0.12), (0.143, 0.12)],
          [(0.143, 0.12), (0.13, 0.08), (0.1, 0.035), (0.05, 0.012), (0, 0.01)]], 48), at=(2.32, hh + 0.0005, -1.05))

    # an ottoman, a tall vase with twigs, pictures on the partition
    s.put('ottoman', diffuse('terracotta', (0.55, 0.2, 0.1)), lathe([[(0, 0.06), (0.27, 0.06)] + arc(0.27, 0.11, 0.05, -90, 0, 8)[1:] + arc(0.27, 0.33, 0.06, 0, 90, 8) + [(0.0, 0.405)]], 64), at=(1.72, 0, -0.35))
    s.put('ottoman_feet', walnut, *[cylinder(0.02, 0, 0.06, 12).move(0.2 * math.cos(k * math.pi / 2 + 0.6), 0, 0.2 * math.sin(k * math.pi / 2 + 0.6)) for k in range(4)], at=(1.72, 0, -0.35))
    vase = [(0, 0), (0.09, 0), (0.13, 0.06), (0.165, 0.16), (0.17, 0.27), (0.14, 0.4), (0.085, 0.5), (0.06, 0.56), (0.062, 0.62), (0.075, 0.65)]
    s.put('vase', diffuse('ceramic', (0.7, 0.66, 0.58)), lathe([vase[:2], vase[1:], [(0.075, 0.65), (0.068, 0.65)], [(0.068, 0.65), (0.054, 0.61), (0.05, 0.5)]], 64), at=(1.5, 0, -2.6))
    twigs, buds = Mesh(), Mesh()
    for k in range(6):
        a, tilt, length = k * 1.05 + 0.3, rng.uniform(0.12, 0.28), rng.uniform(0.5, 0.75)
        line = [(0, 0.5, 0)]
        for i in range(1, 9):
            t = i / 8
            line.append((math.cos(a) * tilt * length * t * (0.4 + 0.9 * t), 0.5 + length * t, math.sin(a) * tilt * length * t * (0.4 + 0.9 * t)))
        twigs.merge(tube(line, [0.006 - 0.004 * i / 8 for i in range(9)], 6))
        for i in range(3, 9):
            p = line[i]
            buds.merge(ball(rng.uniform(0.014, 0.022), 1).stretch(1, 1.3, 1).move(p[0] + rng.uniform(-0.03, 0.03), p[1], p[2] + rng.uniform(-0.03, 0.03)))
    s.put('twigs', diffuse('bark', (0.14, 0.09, 0.06)), twigs, at=(1.5, 0, -2.6))
    s.put('buds', diffuse('bud', (0.75, 0.68, 0.55)), buds, at=(1.5, 0, -2.6))
    mount = diffuse('mount', (0.76, 0.73, 0.66))
    for k, (za, zb, ya, yb, paint) in enumerate(((-0.4, 0.15, 1.05, 1.8, [(0.55, 0.2, 0.1), (0.06, 0.24, 0.27), (0.65, 0.45, 0.15)]), (0.4, 0.95, 1.05, 1.8, [(0.1, 0.16, 0.3), (0.6, 0.3, 0.2), (0.5, 0.48, 0.42)]))):
        s.put(f'picture_{k}_frame', black, *[box(p, q, ('left',)) for p, q in (((px, ya, za), (px + 0.03, ya + 0.025, zb)), ((px, yb - 0.025, za), (px + 0.03, yb, zb)),
              ((px, ya + 0.025, za), (px + 0.03, yb - 0.025, za + 0.025)), ((px, ya + 0.025, zb - 0.025), (px + 0.03, yb - 0.025, zb)))])
        face = lambda x, z0, y0, z1, y1: quad((x, y0, z0), (x, y0, z1), (x, y1, z1), (x, y1, z0), towards=(1, 0, 0))
        s.put(f'picture_{k}', mount, face(px + 0.012, za + 0.02, ya + 0.02, zb - 0.02, yb - 0.02))
        w, hgt = zb - za - 0.2, yb - ya - 0.2
        for j, c in enumerate(paint):
            s.put(f'picture_{k}_{j}', diffuse(f'paint_{k}_{j}', c), face(px + 0.016, za + 0.1, ya + 0.1 + hgt * j / 3, zb - 0.1, ya + 0.1 + hgt * (j + 1) / 3))
    s.camera((1.15, 1.36, 2.5), (0.36, 0.78, -1.3), 43, 1.5)
    return s


def main():
    ap = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    ap.add_argument('names', nargs='*', help='all if none')
    ap.add_argument('-o', '--out', default=os.path.dirname(os.path.abspath(__file__)))
    a = ap.parse_args()
    for name in a.names or SCENES:
        s = SCENES[name]()
        s.write(os.path.join(a.out, name + '.glb'))
        print(f'{name}: {s.triangles} triangles, {os.path.getsize(os.path.join(a.out, name + ".glb"))} bytes')


if __name__ == '__main__':
    main()
