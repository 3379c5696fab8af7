#!/usr/bin/env python3
"""Makes the reference images: loads our glTF scenes into Mitsuba 3 and path-traces them.

    pip install mitsuba==3.9.1 numpy OpenEXR pillow        # and an LLVM library >= 17: apt-get install libllvm19
    python reference/make_reference.py --seconds 120 scenes/pool.glb        # -> reference/pool.exr, reference/pool.json
    python reference/make_reference.py --seconds 600 --state /tmp/s scenes/pool.glb   # adds to the samples kept in /tmp/s
    python reference/make_reference.py --look --png out/ scenes/*.glb              # only looks: tone-mapped PNG, no reference
    python reference/make_reference.py --mask-only reference/glass_sphere.exr scenes/glass_sphere.glb

Nothing here shares code with the renderer.

What is rendered
    256 columns, round(256 / aspect) rows, box filter, radiance in linear Rec. 709.  Materials, sides and lights are read by the
    conventions of scenes/README.md.  Geometry, intersection and scattering (`diffuse`, `conductor`, `dielectric`,
    `thindielectric`) are Mitsuba's; the path loop is below because Mitsuba's `path` finds light behind a planar mirror or a
    window pane only by chance, and light of a spot behind a mirror never:

    planar chains    At each diffuse hit the emitters are sampled directly and through every sequence of at most `chains`
                     planar mirrors by the mirror image of the sample point; the sequence is then followed by ray casting,
                     and panes on the way take their Fresnel share.  Combined with scattering by multiple importance
                     sampling (power heuristic): both techniques know the density of a path from its unfolded length.
    everything else  (curved mirrors, glass, longer chains, reflections in panes) is found by scattering alone.
    light tracing    Where that is hopeless (a bulb in a closed glass shell, a small light behind glass) the paths whose first surface from the eye is
                     diffuse or emissive come from Mitsuba's stock `ptracer`, and only those whose first surface is a
                     mirror or glass from the path loop.  Together they are a partition.  The certificate says so.
                     (Stock `ptracer` knows no attenuation in glass: not for scenes that have it.)
    caustics         Where only light by way of curved mirrors and glass is hopeless, the paths light - curved or refracting -
                     diffuse - anything - diffuse - eye come from a light-tracing loop, which meets the eye directly and by
                     way of the planar chains, and are left out of the path loop, again a partition.
    spot lights      I(angle) of KHR_lights_punctual: saturate((cos - cos outer) / (cos inner - cos outer))^2.
    attenuation      attenuationColor^(t / attenuationDistance) along the path inside the glass.
    furnaces         exact: all walls emit L and reflect rho, so every pixel is L / (1 - rho); no rendering.

Checked
    against the older references of cornell_mirror, mirror_light_shaft, ring_caustic and glass_sphere, made by another script: mean
    luminance within 0.1 %, rms z of 16 x 16 blocks 0.96 to 1.05; light-traced caustic of glass_sphere inside its mask: 1.0001;
    bulb_in_glass by the path loop alone: 0.997 +- 0.0025; glass_furnace and mirror_furnace by the path loop: within 5e-4.

EXR channels
    R, G, B         the image
    SE.R, SE.G, SE.B  the standard error of each pixel's mean, from the variance of batches of 16 samples
    mask            (scenes with curved mirrors or glass) 1 where the caustic lies: the share of paths
                    light - one curved or refracting event or more - diffuse - (mirrors and glass) - eye
                    in the luminance, both smoothed over 5 x 5 pixels, is above MASK_SHARE; with light tracing that
                    share is the image minus the image with all glass and curved mirrors painted black
    float32, ZIP.  To keep the repository small R, G, B are rounded to a step of at most SE / 8 (unbiased; adds less than
    0.2 % to the noise variance) and to 12 significant bits at most, SE to 5; exact references are not rounded.

The JSON beside it is the birth certificate: renderer and version, samples, seed, time, standard error, scene hash, licence, limits.
`limits` are those of `catoptric diff` (docs/diff.md) at quality `standard`; FLIP counts only where the reference's own noise scores at
most 0.02. `mask_limits` hold inside the mask. p99.5_rel instead of max_rel exempts half a per cent of the pixels.
"""
import argparse, base64, glob, hashlib, itertools, json, math, os, struct, sys, tempfile, time
import numpy as np

WIDTH = 256
BATCH = 16
MASK_SHARE = 0.25
LUM = np.array([0.2126, 0.7152, 0.0722])

# limits at quality `standard`
PLANAR = dict(relMSE_nc=2e-4, relMSE_b8=4e-4, FLIP=0.05, p95_rel=0.15, lum_ratio=0.003, lum_ratio_trim=0.003)
INTERIOR = dict(PLANAR, relMSE_nc=1e-3, relMSE_b8=1e-3)
RING = dict(PLANAR, relMSE_nc=1e-3, relMSE_b8=1e-3, FLIP=0.03)
GLASS = dict(PLANAR, relMSE_nc=3e-3, relMSE_b8=3e-3, FLIP=0.04)
MASK = dict(lum_ratio=0.02, relMSE_nc=3e-2)
EXACT = dict(max_rel=1e-3)

# chains: longest sequence of planar mirrors sampled directly; panes: panes that one straight segment can cross
SETTINGS = {
    'cornell_box': dict(limits=PLANAR),
    'cornell_mirror': dict(limits=PLANAR),
    'mirror_light_shaft': dict(chains=1, limits=INTERIOR),
    'ring_caustic': dict(limits=RING),
    'glass_sphere': dict(limits=GLASS),
    'interior': dict(chains=1, limits=INTERIOR),
    'furnace_box': dict(limits=EXACT),
    'furnace_mirror': dict(limits={'p99.5_rel': 1e-3}),
    'showcase': dict(chains=1, light_tracing='caustics', limits=GLASS),
    'spot_mirror': dict(chains=1, limits=PLANAR),
    'bulb_in_glass': dict(light_tracing='all', limits=GLASS),
    'caustic_pane_mirror': dict(chains=1, panes=1, light_tracing='caustics', limits=GLASS),
    'window_pane_room': dict(panes=1, limits=INTERIOR),
    'pool': dict(light_tracing='caustics', limits=GLASS),
    'two_mirrors': dict(chains=2, limits=INTERIOR),
    'facing_mirrors': dict(chains=4, limits=PLANAR),
    'mirror_corner': dict(chains=2, limits=PLANAR),
    'glass_furnace': dict(exact='furnace', limits=EXACT),
    'mirror_furnace': dict(exact='furnace', limits=EXACT),
    'sky_body': dict(sky=[1.0, 1.0, 1.0], limits={'p98_rel': 1e-3}),
    'contacts': dict(limits=PLANAR),
}


# ---------------------------------------------------------------------------------------------------------------- glTF

def local_matrix(node):
    if 'matrix' in node:
        return np.array(node['matrix'], float).reshape(4, 4).T
    m = np.eye(4)
    x, y, z, w = node.get('rotation', [0, 0, 0, 1])
    v, k = np.array([x, y, z]), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    m[:3, :3] = (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * k
    m[:3, :3] = m[:3, :3] * np.array(node.get('scale', [1, 1, 1]), float)
    m[:3, 3] = node.get('translation', [0, 0, 0])
    return m


def read_material(m):
    pbr, ext = m.get('pbrMetallicRoughness', {}), m.get('extensions', {})
    base = np.array(pbr.get('baseColorFactor', [1, 1, 1, 1])[:3], float)
    strength = ext.get('KHR_materials_emissive_strength', {}).get('emissiveStrength', 1.0)
    volume = ext.get('KHR_materials_volume', {})
    sigma = np.zeros(3)
    if 'attenuationDistance' in volume:
        sigma = -np.log(np.array(volume.get('attenuationColor', [1, 1, 1]))) / volume['attenuationDistance']
    if ext.get('KHR_materials_transmission', {}).get('transmissionFactor', 0) == 1:
        kind = 'glass' if volume.get('thicknessFactor', 0) > 0 else 'pane'
    elif pbr.get('metallicFactor', 1.0) == 1 and pbr.get('roughnessFactor', 1.0) == 0:
        kind = 'mirror'
    elif pbr.get('metallicFactor', 1.0) == 0:
        kind = 'diffuse'
    else:
        raise ValueError(f'material {m.get("name")}: outside the conventions')
    return dict(name=m.get('name', ''), kind=kind, base=base, sigma=sigma, double=m.get('doubleSided', False),
                emission=np.array(m.get('emissiveFactor', [0, 0, 0]), float) * strength,
                ior=ext.get('KHR_materials_ior', {}).get('ior', 1.5))


def load_glb(path):
    """-> dict(meshes, camera, lights): world-space triangles, one mesh per primitive"""
    raw = open(path, 'rb').read()
    assert raw[:4] == b'glTF', path
    chunks, at = {}, 12
    while at < len(raw):
        size, tag = struct.unpack_from('<I4s', raw, at)
        chunks[tag] = raw[at + 8:at + 8 + size]
        at += 8 + size
    doc, blob = json.loads(chunks[b'JSON']), chunks.get(b'BIN\0', b'')

    def accessor(i):
        a = doc['accessors'][i]
        view = doc['bufferViews'][a['bufferView']]
        dtype = np.dtype({5121: '<u1', 5123: '<u2', 5125: '<u4', 5126: '<f4'}[a['componentType']])
        width = {'SCALAR': 1, 'VEC2': 2, 'VEC3': 3, 'VEC4': 4}[a['type']]
        start = view.get('byteOffset', 0) + a.get('byteOffset', 0)
        assert view.get('byteStride', dtype.itemsize * width) == dtype.itemsize * width
        return np.frombuffer(blob, dtype, a['count'] * width, start).reshape(-1, width)

    materials = [read_material(m) for m in doc.get('materials', [])]
    meshes, cameras, lights = [], [], []

    def visit(i, world):
        node = doc['nodes'][i]
        world = world @ local_matrix(node)
        for prim in doc['meshes'][node['mesh']]['primitives'] if 'mesh' in node else []:
            P = accessor(prim['attributes']['POSITION']).astype(float) @ world[:3, :3].T + world[:3, 3]
            F = accessor(prim['indices']).reshape(-1, 3).astype(int)
            N = None
            if 'NORMAL' in prim['attributes']:
                N = accessor(prim['attributes']['NORMAL']).astype(float) @ np.linalg.inv(world[:3, :3])
                N /= np.linalg.norm(N, axis=1, keepdims=True)
            meshes.append(dict(name=node.get('name', f'node {i}'), P=P, N=N, F=F, material=materials[prim['material']]))
        if 'camera' in node:
            c = doc['cameras'][node['camera']]['perspective']
            cameras.append(dict(world=world, yfov=c['yfov'], aspect=c['aspectRatio']))
        if 'KHR_lights_punctual' in node.get('extensions', {}):
            k = doc['extensions']['KHR_lights_punctual']['lights'][node['extensions']['KHR_lights_punctual']['light']]
            assert k['type'] in ('spot', 'point'), 'directional lights: not yet'
            cone = k.get('spot', {})
            lights.append(dict(position=world[:3, 3], axis=-world[:3, 2] / np.linalg.norm(world[:3, 2]), type=k['type'],
                               intensity=np.array(k.get('color', [1, 1, 1])) * k.get('intensity', 1.0),
                               inner=math.cos(cone.get('innerConeAngle', 0.0)),
                               outer=math.cos(cone.get('outerConeAngle', math.pi / 4))))
        for child in node.get('children', []):
            visit(child, world)

    for root in doc['scenes'][doc.get('scene', 0)]['nodes']:
        visit(root, np.eye(4))
    return dict(name=os.path.splitext(os.path.basename(path))[0], meshes=meshes, camera=cameras[0], lights=lights,
                sha256=hashlib.sha256(raw).hexdigest())


def check_winding(scene):
    """Vertex normals must agree with the winding of their triangles."""
    for mesh in scene['meshes']:
        a, b, c = (mesh['P'][mesh['F'][:, k]] for k in range(3))
        g = np.cross(b - a, c - a)
        if (np.linalg.norm(g, axis=1) == 0).any():
            print(f'{scene["name"]}/{mesh["name"]}: degenerate triangles')
        if mesh['N'] is not None:
            bad = sum(int((np.einsum('ij,ij->i', g, mesh['N'][mesh['F'][:, k]]) < 0).any()) for k in range(3))
            if bad:
                print(f'{scene["name"]}/{mesh["name"]}: normals against the winding')


# ------------------------------------------------------------------------------------------------------------- Mitsuba

def start_mitsuba():
    if 'DRJIT_LIBLLVM_PATH' not in os.environ:
        found = [p for v in range(22, 16, -1) for p in sorted(glob.glob(f'/usr/lib/*/libLLVM*{v}*'))]
        if found:
            os.environ['DRJIT_LIBLLVM_PATH'] = found[0]
    # module globals: the functions that Dr.Jit recompiles have no closure
    global mi, dr, loop, emission_loop, bounce_loop
    import mitsuba as mi
    mi.set_variant('llvm_ad_rgb')
    import drjit as dr
    loop, emission_loop, bounce_loop = dr.syntax(trace_paths), dr.syntax(emit_light), dr.syntax(bounce_light)


def write_ply(path, mesh, with_normals):
    columns = [mesh['P'], mesh['N']] if with_normals else [mesh['P']]
    names = ['x', 'y', 'z', 'nx', 'ny', 'nz'][:3 * len(columns)]
    faces = np.empty(len(mesh['F']), [('n', 'u1'), ('v', '<i4', 3)])
    faces['n'], faces['v'] = 3, mesh['F']
    with open(path, 'wb') as f:
        head = ['ply', 'format binary_little_endian 1.0', f'element vertex {len(mesh["P"])}']
        head += [f'property float {n}' for n in names]
        head += [f'element face {len(faces)}', 'property list uchar int vertex_indices', 'end_header', '']
        f.write('\n'.join(head).encode())
        f.write(np.concatenate(columns, 1).astype('<f4').tobytes())
        f.write(faces.tobytes())


def mitsuba_bsdf(m):
    rgb = lambda c: {'type': 'rgb', 'value': [float(x) for x in c]}
    if m['kind'] in ('glass', 'pane'):
        return {'type': 'dielectric' if m['kind'] == 'glass' else 'thindielectric', 'int_ior': float(m['ior']), 'ext_ior': 1.0,
                'specular_transmittance': rgb(m['base'])}
    if m['kind'] == 'mirror':
        one = {'type': 'conductor', 'material': 'none', 'specular_reflectance': rgb(m['base'])}
    else:
        one = {'type': 'diffuse', 'reflectance': rgb(m['base'])}
    return {'type': 'twosided', 'bsdf': one} if m['double'] else one


def resolution(scene, width):
    return width, int(round(width / scene['camera']['aspect']))


def mitsuba_scene(scene, width):
    """-> Mitsuba scene; its shapes are in the order of scene['meshes']"""
    cam = scene['camera']
    w, h = resolution(scene, width)
    d = {'type': 'scene', 'sensor': {
        # a glTF camera looks along -Z with +X to the right, Mitsuba's along +Z with +X to the left
        'type': 'perspective', 'to_world': mi.ScalarTransform4f(cam['world'] @ np.diag([-1.0, 1.0, -1.0, 1.0])),
        'fov_axis': 'y', 'fov': math.degrees(cam['yfov']), 'near_clip': 1e-3, 'far_clip': 1e3,
        'film': {'type': 'hdrfilm', 'width': w, 'height': h, 'pixel_format': 'rgb', 'component_format': 'float32',
                 'rfilter': {'type': 'box'}},
        'sampler': {'type': 'independent', 'sample_count': 1}}}
    with tempfile.TemporaryDirectory() as tmp:
        for i, mesh in enumerate(scene['meshes']):
            m, file = mesh['material'], os.path.join(tmp, f'{i}.ply')
            lit = m['emission'].max() > 0
            assert not (lit and m['double']), 'an emitter on both sides: use two surfaces'
            # emitters are flat: power follows the geometry
            write_ply(file, mesh, mesh['N'] is not None and not lit)
            d[f'shape_{i:04d}'] = {'type': 'ply', 'filename': file, 'bsdf': mitsuba_bsdf(m), 'face_normals': mesh['N'] is None or lit}
            if lit:
                d[f'shape_{i:04d}']['emitter'] = {'type': 'area', 'radiance': {'type': 'rgb', 'value': [float(x) for x in m['emission']]}}
        return mi.load_dict(d, optimize=False)      # shapes stay apart


def plane_of(mesh):
    """(point, unit normal) of a planar mesh, else None"""
    a, b, c = (mesh['P'][mesh['F'][:, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    if (n @ n[0] < 1 - 1e-6).any() or (np.abs((mesh['P'] - mesh['P'][0]) @ n[0]) > 1e-5).any():
        return None
    return [float(x) for x in mesh["P"][0]], [float(x) for x in n[0]]


class PathTracer:
    """The path loop of the module documentation, for all pixels at once."""

    def __init__(self, scene, width, chains=0, panes=0, specular_first=False, drop_caustics=False):
        self.scene, self.panes, self.specular_first, self.drop_caustics = scene, panes, specular_first, drop_caustics
        self.size = resolution(scene, width)
        self.world = mitsuba_scene(scene, width)
        self.sensor = self.world.sensors()[0]
        meshes = scene['meshes']
        F, U = mi.Float, mi.UInt32

        # tables by shape: Mitsuba numbers shapes from 1
        number = np.array(dr.reinterpret_array(U, self.world.shapes_dr()))
        by_id = [int(s.id().split('_')[1]) for s in self.world.shapes()]
        slot = np.zeros(number.max() + 1, int)
        slot[number] = by_id
        order = [meshes[i] for i in slot]
        kinds = ['diffuse', 'mirror', 'pane', 'glass']
        self.kind = U([kinds.index(m['material']['kind']) for m in order])
        self.double = U([int(m['material']['double']) for m in order])
        self.base = [F([m['material']['base'][k] for m in order]) for k in range(3)]
        self.emission = [F([m['material']['emission'][k] for m in order]) for k in range(3)]
        self.sigma = [F([m['material']['sigma'][k] for m in order]) for k in range(3)]
        self.ior = F([m['material']['ior'] for m in order])

        # emissive triangles, chosen by power
        tri = [(mesh['P'][f], mesh['material']['emission']) for mesh in meshes if mesh['material']['emission'].max() > 0
               for f in mesh['F']]
        self.lit = bool(tri)
        if tri:
            corner = np.array([t[0] for t in tri])
            cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
            area = np.linalg.norm(cross, axis=1) / 2
            power = np.array([e @ LUM for _, e in tri]) * area
            self.light_cdf = mi.DiscreteDistribution(F(power))
            self.corner = [mi.Point3f(*[F(corner[:, k, j]) for j in range(3)]) for k in range(3)]
            self.light_normal = mi.Normal3f(*[F(cross[:, j] / (2 * area)) for j in range(3)])
            self.light_radiance = mi.Color3f(*[F([e[j] for _, e in tri]) for j in range(3)])
            self.light_density = F(np.array([e @ LUM for _, e in tri]) / power.sum())
            self.density = F([m['material']['emission'] @ LUM / power.sum() for m in order])

        # planar mirrors and their sequences; code = digits of the sequence in base mirrors + 1
        self.planes, plane_id = [], {}
        for i, mesh in enumerate(meshes):
            if mesh['material']['kind'] == 'mirror' and chains and plane_of(mesh):
                self.planes.append(plane_of(mesh))
                plane_id[i] = len(self.planes)
        self.plane_id = U([plane_id.get(int(i), 0) for i in slot])
        m = len(self.planes)
        self.chains = [c for k in range(chains + 1) for c in itertools.product(range(m), repeat=k)
                       if all(a != b for a, b in zip(c, c[1:]))]
        self.longest = chains

    def look_up(self, table, shape, active=True):
        if isinstance(table, list):
            return mi.Color3f(*[dr.gather(mi.Float, t, shape, active) for t in table])
        return dr.gather(type(table), table, shape, active)

    def follow(self, ray, chain, target, active):
        """Throughput of the straight way to `target` by way of the mirrors of `chain`; 0 where it is blocked."""
        tau = mi.Color3f(1)
        for m in list(chain) + [None]:
            for _ in range(self.panes):
                si = self.world.ray_intersect(ray, active)
                shape = dr.reinterpret_array(mi.UInt32, si.shape)
                pane = active & si.is_valid() & (self.look_up(self.kind, shape, active) == 2)
                if m is None:
                    pane &= si.t < dr.norm(target - ray.o)
                r = mi.fresnel(dr.abs(dr.dot(si.n, ray.d)), self.look_up(self.ior, shape, pane))[0]
                tau = dr.select(pane, tau * (1 - r) / (1 + r) * self.look_up(self.base, shape, pane), tau)
                ray = dr.select(pane, si.spawn_ray(ray.d), ray)
            if m is None:
                # aim again: the origin was moved off the surface
                d = target - ray.o
                last = mi.Ray3f(ray.o, dr.normalize(d))
                last.maxt = dr.norm(d) * (1 - 1e-3)
                active = active & ~self.world.ray_test(last, active)
            else:
                si = self.world.ray_intersect(ray, active)
                shape = dr.reinterpret_array(mi.UInt32, si.shape)
                front = (dr.dot(si.n, ray.d) < 0) | (self.look_up(self.double, shape, active) == 1)
                active = active & si.is_valid() & front & (self.look_up(self.plane_id, shape, active) == m + 1)
                tau = tau * self.look_up(self.base, shape, active)
                n = mi.Normal3f(*self.planes[m][1])
                ray = si.spawn_ray(ray.d - 2 * dr.dot(n, ray.d) * n)
        return dr.select(active, tau, 0)

    def image(self, chain, point, *directions):
        """The point and directions as seen from before the first mirror of the chain."""
        for m in reversed(chain):
            p, n = mi.Point3f(*self.planes[m][0]), mi.Normal3f(*self.planes[m][1])
            point = point - 2 * dr.dot(n, point - p) * n
            directions = [v - 2 * dr.dot(n, v) * n for v in directions]
        return point, *directions

    def light(self, rng, si, bsdf, active):
        """Emitters and spots seen from a diffuse point, directly and by way of planar chains."""
        total = mi.Color3f(0)
        for chain in self.chains:
            if self.lit:
                t = self.light_cdf.sample(rng.next_float32(), active)
                u, v = dr.sqrt(rng.next_float32()), rng.next_float32()
                a, b, c = (dr.gather(mi.Point3f, self.corner[k], t) for k in range(3))
                target = (1 - u) * a + u * (1 - v) * b + u * v * c
                seen, normal = self.image(chain, target, dr.gather(mi.Normal3f, self.light_normal, t))
                d = seen - si.p
                square = dr.squared_norm(d)
                d *= dr.rsqrt(square)
                cos_light, wo = -dr.dot(normal, d), si.to_local(d)
                ok = active & (cos_light > 1e-6) & (wo.z * si.wi.z > 0)       # either side of what has two
                p_light = dr.gather(mi.Float, self.light_density, t) * square / cos_light
                p_scatter = dr.abs(wo.z) * dr.inv_pi
                weight = p_light / (dr.square(p_light) + dr.square(p_scatter))      # power heuristic / p_light
                value = bsdf.eval(mi.BSDFContext(), si, wo, ok) * self.follow(si.spawn_ray(d), chain, target, ok)
                total += dr.select(ok, value * dr.gather(mi.Color3f, self.light_radiance, t) * weight, 0)
            for k in self.scene['lights']:
                target = mi.Point3f(k['position'].tolist())
                seen, axis = self.image(chain, target, mi.Vector3f(k['axis'].tolist()))
                d = seen - si.p
                square = dr.squared_norm(d)
                d *= dr.rsqrt(square)
                wo = si.to_local(d)
                cone = dr.clip((-dr.dot(axis, d) - k['outer']) / (k['inner'] - k['outer']), 0, 1) if k['type'] == 'spot' else 1
                ok = active & (wo.z * si.wi.z > 0)
                value = bsdf.eval(mi.BSDFContext(), si, wo, ok) * self.follow(si.spawn_ray(d), chain, target, ok)
                total += dr.select(ok, value * mi.Color3f(k['intensity'].tolist()) * dr.square(mi.Float(cone)) / square, 0)
        return total

    def pixels(self):
        """Numbers of the pixels that have anything to render."""
        w, h = self.size
        everything = np.arange(w * h)
        if not self.specular_first:
            return everything
        # those that see a mirror or glass first, and their neighbours
        n = w * h * 256
        pixel, rng = dr.arange(mi.UInt32, n) // 256, mi.PCG32(size=n)
        x, y = (mi.Float(pixel % w) + rng.next_float32()) / w, (mi.Float(pixel // w) + rng.next_float32()) / h
        si = self.world.ray_intersect(self.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))[0])
        kind = self.look_up(self.kind, dr.reinterpret_array(mi.UInt32, si.shape), si.is_valid())
        hit = np.pad(np.array(dr.select(si.is_valid() & (kind != 0), 1, 0)).reshape(h, w, 256).any(-1), 1)
        near = np.any([hit[i:i + h, j:j + w] for i in range(3) for j in range(3)], 0)
        return everything[near.reshape(-1)]

    def caustic_pass(self, seed, paths):
        """-> (pixels, 6): light by way of curved mirrors and glass where the camera sees it on diffuse surfaces, directly and
        in planar mirrors, by light tracing; its part that came to the surface seen without another diffuse one between"""
        w, h = self.size
        rng = mi.PCG32(size=paths, initstate=dr.opaque(mi.UInt64, 0x2545f4914f6cdd1d + 7919 * seed))
        ray, power, sigma, found = emission_loop(self, rng, paths)
        dr.eval(ray, power, sigma, found)
        kept = dr.compress(found)
        image = [dr.zeros(mi.Float, w * h) for _ in range(6)]
        dr.eval(image)
        n = dr.width(kept)
        if n:
            ray, power, sigma = (dr.gather(type(v), v, kept) for v in (ray, power, sigma))
            rng = mi.PCG32(size=n, initstate=dr.opaque(mi.UInt64, 0x3c6ef372fe94f82b + 7919 * seed))
            dr.eval(bounce_loop(self, rng, ray, power, sigma, image))
            dr.eval(image)
        return np.stack([np.array(v, np.float64) for v in image], -1) * (w * h / paths)

    def meet_camera(self, si, power, bsdf, context, direction, active, image, first):
        """Adds the light that a diffuse point sends to the camera, directly and by way of the planar chains, to the image."""
        w, h = self.size
        eye = mi.Point3f(self.scene['camera']['world'][:3, 3].tolist())
        for chain in self.chains:
            # the point as the camera sees it behind the mirrors, which it meets in the other order, and the way back
            seen = dr.zeros(mi.Interaction3f)
            seen.p = self.image(chain[::-1], mi.Point3f(si.p))[0]
            ds, importance = self.sensor.sample_direction(seen, mi.Point2f(0.5), active)
            d = self.image(chain, mi.Point3f(0), mi.Vector3f(ds.d))[1]
            ok = active & (ds.pdf > 0)
            tau = self.follow(si.spawn_ray(d), chain, eye, ok)
            wo = si.to_local(d)
            value = power * importance * bsdf.eval(context, si, wo, ok) * adjoint(si, direction, wo, d) * tau
            x, y = dr.floor(ds.uv.x), dr.floor(ds.uv.y)
            ok &= (x >= 0) & (x < w) & (y >= 0) & (y < h) & (dr.max(value) > 0)
            pixel = mi.UInt32(y) * w + mi.UInt32(x)
            for k in range(3):
                dr.scatter_reduce(dr.ReduceOp.Add, image[k], value[k], pixel, ok)
                dr.scatter_reduce(dr.ReduceOp.Add, image[3 + k], value[k], pixel, ok & first)

    def render_pass(self, seed, pixels, batches):
        """-> batch means (pixels, batches, 6): radiance and its caustic part"""
        w, h = self.size
        n = len(pixels) * batches * BATCH
        lane = dr.arange(mi.UInt32, n)
        pixel = dr.gather(mi.UInt32, mi.UInt32(pixels), lane // (batches * BATCH))
        rng = mi.PCG32(size=n, initstate=dr.opaque(mi.UInt64, 0x53c49e6748fea9b + 7919 * seed))
        x = (mi.Float(pixel % w) + rng.next_float32()) / w
        y = (mi.Float(pixel // w) + rng.next_float32()) / h
        ray, _ = self.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
        L, caustic = loop(self, rng, ray)
        L, caustic = L + dr.zeros(mi.Color3f, n), caustic + dr.zeros(mi.Color3f, n)
        dr.eval(L, caustic)
        out = [dr.block_sum(v, BATCH) / BATCH for v in (*L, *caustic)]
        return np.stack([np.array(v, np.float64) for v in out], -1).reshape(len(pixels), batches, 6)


def trace_paths(self, rng, ray):
    """One path per lane; -> (radiance, its part that came to the first diffuse surface by a curved mirror or glass)"""
    L, caustic, beta, sigma = mi.Color3f(0), mi.Color3f(0), mi.Color3f(1), mi.Color3f(0)
    depth, code, mirrors, diffuse, crossed = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
    sampled, curved, active, plain = mi.Bool(True), mi.Bool(False), mi.Bool(True), mi.Bool(True)
    length, p_scatter, eta = mi.Float(0), mi.Float(0), mi.Float(1)
    ray = mi.Ray3f(ray)
    while active:
        si = self.world.ray_intersect(ray, active)
        active &= si.is_valid()
        shape = dr.reinterpret_array(mi.UInt32, si.shape)
        kind = self.look_up(self.kind, shape, active)
        beta *= dr.select(active, dr.exp(-sigma * si.t), 1)
        length += dr.select(active, si.t, 0)
        if dr.hint(self.specular_first, mode='scalar'):
            active &= (depth > 0) | (kind != 0)

        # an emitter that this path met by scattering
        if dr.hint(self.lit, mode='scalar'):
            cos_light = -dr.dot(si.n, ray.d)
            p_light = self.look_up(self.density, shape, active) * dr.square(length) / cos_light
            known = sampled & (mirrors <= self.longest) & (diffuse > 0)
            weight = dr.select(known, dr.square(p_scatter) / (dr.square(p_light) + dr.square(p_scatter)), 1)
            glow = dr.select(active & (cos_light > 1e-6), beta * self.look_up(self.emission, shape, active) * weight, 0)
            if dr.hint(self.drop_caustics, mode='scalar'):
                glow = dr.select(curved & (diffuse > 0) & plain, 0, glow)
            L += glow
            caustic += dr.select(curved & (diffuse == 1), glow, 0)

        # light on a diffuse surface
        bsdf = si.bsdf()
        here = active & (kind == 0)
        if here:
            L += beta * self.light(rng, si, bsdf, here)

        # scatter
        bs, weight = bsdf.sample(mi.BSDFContext(), si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32()), active)
        beta *= dr.select(active, weight, 1)
        passed = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
        refracted = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission) & (kind == 3)
        sigma = dr.select(refracted, dr.select(bs.wo.z < 0, self.look_up(self.sigma, shape, active), 0), sigma)
        eta *= dr.select(refracted, bs.eta, 1)
        plane = self.look_up(self.plane_id, shape, active)
        # more panes in a straight segment are not followed: scattering alone finds what is behind
        crossed = dr.select(passed, crossed + 1, 0)
        sampled = here | (sampled & (plane > 0)) | (sampled & passed & (crossed <= self.panes))
        curved = ~here & (curved | (kind == 3) | ((kind == 1) & (plane == 0)))
        mirrors = dr.select(here, 0, mirrors + dr.select(plane > 0, 1, 0))
        # the first diffuse surface is seen directly or by way of a planar chain
        plain &= here | (diffuse > 0) | ((plane > 0) & (mirrors <= self.longest))
        length = dr.select(here, 0, length)
        p_scatter = dr.select(here, bs.pdf, p_scatter)
        diffuse += dr.select(here, 1, 0)
        ray = si.spawn_ray(si.to_world(bs.wo))
        depth += 1

        # roulette
        survive = dr.minimum(dr.max(beta) * dr.square(eta), 0.98)
        dice = depth >= 12
        active &= (dr.max(beta) > 0) & (~dice | (rng.next_float32() < survive))
        beta *= dr.select(dice, 1 / dr.maximum(survive, 1e-6), 1)
    return L, caustic


def emit_light(self, rng, n):
    """Light paths up to their first diffuse surface; -> (ray that meets it, power, attenuation on the way, whether they came there
    by way of a curved mirror or glass)"""
    t = self.light_cdf.sample(rng.next_float32())
    u, v = dr.sqrt(rng.next_float32()), rng.next_float32()
    a, b, c = (dr.gather(mi.Point3f, self.corner[k], t) for k in range(3))
    normal = dr.gather(mi.Normal3f, self.light_normal, t)
    start = (1 - u) * a + u * (1 - v) * b + u * v * c
    out = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32())))
    power = dr.gather(mi.Color3f, self.light_radiance, t) * dr.pi / dr.gather(mi.Float, self.light_density, t)
    ray = mi.Ray3f(start + 1e-4 * normal, out)
    sigma = mi.Color3f(0)
    depth, curved, active, found = mi.UInt32(0), mi.Bool(False), mi.Bool(True), mi.Bool(False)
    while active:
        si = self.world.ray_intersect(ray, active)
        active &= si.is_valid()
        shape = dr.reinterpret_array(mi.UInt32, si.shape)
        kind = self.look_up(self.kind, shape, active)
        found |= active & (kind == 0) & curved
        active &= kind != 0
        ray, power, sigma, crossed = scatter_light(self, rng, ray, si, shape, kind, power, sigma, active)
        curved |= crossed
        depth += 1
        active &= (dr.max(power) > 0) & (depth < 128)
    return ray, power, sigma, found


def bounce_light(self, rng, ray, power, sigma, image):
    """Follows light paths from the ray that meets their first diffuse surface; each diffuse surface sends light to the camera."""
    context = mi.BSDFContext(mi.TransportMode.Importance)
    depth, diffuse, active = mi.UInt32(0), mi.UInt32(0), mi.Bool(True)
    ray, power, sigma = mi.Ray3f(ray), mi.Color3f(power), mi.Color3f(sigma)
    while active:
        si = self.world.ray_intersect(ray, active)
        active &= si.is_valid()
        shape = dr.reinterpret_array(mi.UInt32, si.shape)
        kind = self.look_up(self.kind, shape, active)
        here = active & (kind == 0)
        if here:
            self.meet_camera(si, power * dr.exp(-sigma * si.t), si.bsdf(), context, ray.d, here, image, diffuse == 0)
        diffuse += dr.select(here, 1, 0)
        before = dr.max(power)
        ray, power, sigma, _ = scatter_light(self, rng, ray, si, shape, kind, power, sigma, active)
        depth += 1

        # roulette by what this bounce leaves
        survive = dr.minimum(dr.max(power) / dr.maximum(before, 1e-30), 0.98)
        dice = depth >= 4
        active &= (dr.max(power) > 0) & (~dice | (rng.next_float32() < survive))
        power *= dr.select(dice, 1 / dr.maximum(survive, 1e-6), 1)
    return depth


def adjoint(si, arrives, wo, leaves):
    """What light loses or gains where normals are interpolated (Veach 1997, section 5.3.2); `wo`: `leaves` in the shading frame"""
    return dr.abs(si.wi.z * dr.dot(si.n, leaves)) / dr.maximum(dr.abs(wo.z * dr.dot(si.n, arrives)), 1e-6)


def scatter_light(self, rng, ray, si, shape, kind, power, sigma, active):
    """One event of a light path; -> (ray, power, attenuation, whether it was one of a curved mirror or of glass)"""
    context = mi.BSDFContext(mi.TransportMode.Importance)
    power = power * dr.select(active, dr.exp(-sigma * si.t), 1)
    bs, weight = si.bsdf().sample(context, si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32()), active)
    direction = si.to_world(bs.wo)
    factor = dr.select(mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null), 1, adjoint(si, ray.d, bs.wo, direction))
    power = power * dr.select(active, weight * factor, 1)
    refracted = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission) & (kind == 3)
    inside = dr.select(bs.wo.z < 0, self.look_up(self.sigma, shape, active), 0)
    sigma = dr.select(active & refracted, inside, sigma)
    crossed = active & ((kind == 3) | ((kind == 1) & (self.look_up(self.plane_id, shape, active) == 0)))
    return dr.select(active, si.spawn_ray(direction), ray), power, sigma, crossed


# --------------------------------------------------------------------------------------------------------------- sums

class Sums:
    """Running sums of batch means; can be kept in a file and added to."""

    def __init__(self, pixels):
        self.n, self.seed, self.seconds, self.spp = 0, 0, 0.0, 0
        self.s, self.q = np.zeros((pixels, 6)), np.zeros((pixels, 3))

    def add(self, batch_means, spp, seconds):
        self.n += batch_means.shape[1]
        self.seed += 1
        self.spp += spp
        self.seconds += seconds
        self.s += batch_means.sum(1)
        self.q += (batch_means[..., :3] ** 2).sum(1)

    def mean(self):
        return self.s / max(self.n, 1)

    def variance(self):
        m = self.mean()[:, :3]
        return np.maximum(self.q / self.n - m ** 2, 0) / max(self.n - 1, 1)

    def save(self, path, key):
        np.savez(path, key=key, n=self.n, seed=self.seed, seconds=self.seconds, spp=self.spp, s=self.s, q=self.q)

    def load(self, path, key):
        z = np.load(path)
        if str(z['key']) == key and z['s'].shape == self.s.shape:
            self.n, self.seed, self.seconds, self.spp = int(z['n']), int(z['seed']), float(z['seconds']), z['spp'].item()
            self.s, self.q = z['s'], z['q']


def path_sums(scene, width, seconds, state, settings):
    tracer = PathTracer(scene, width, settings.get('chains', 0), settings.get('panes', 0), settings.get('light_tracing') == 'all',
                        settings.get('light_tracing') == 'caustics')
    w, h = tracer.size
    sums = Sums(w * h)
    file = state and os.path.join(state, f'{scene["name"]}_{width}_path_{settings.get("light_tracing", "only")}.npz')
    if file and os.path.exists(file):
        sums.load(file, scene['sha256'])
    pixels = tracer.pixels()
    if not len(pixels):     # light tracing sees all there is
        for _ in range(2):
            sums.add(np.zeros((w * h, 1, 6)), BATCH, 0.0)
        return sums
    batches = max(1, 2 ** 21 // (len(pixels) * BATCH))
    end = time.time() + seconds
    while time.time() < end or sums.n < 2:
        t = time.time()
        means = np.zeros((w * h, batches, 6))
        means[pixels] = tracer.render_pass(sums.seed, pixels, batches)
        sums.add(means, batches * BATCH, time.time() - t)
    if file:
        sums.save(file, scene['sha256'])
    return sums


def without_caustics(scene):
    """All glass and curved mirrors painted black."""
    black = dict(name='black', kind='diffuse', base=np.zeros(3), sigma=np.zeros(3), double=True, emission=np.zeros(3), ior=1.0)
    meshes = [dict(m, material=black) if makes_caustics(m) else m for m in scene['meshes']]
    return dict(scene, meshes=meshes, name=scene['name'] + '_black')


def makes_caustics(mesh):
    return mesh['material']['kind'] == 'glass' or (mesh['material']['kind'] == 'mirror' and not plane_of(mesh))


def caustic_sums(scene, width, seconds, state, settings):
    """Light tracing of what comes by way of curved mirrors and glass."""
    # no panes: what is seen through one belongs to the path loop
    tracer = PathTracer(scene, width, settings.get('chains', 0))
    w, h = tracer.size
    sums = Sums(w * h)
    file = state and os.path.join(state, f'{scene["name"]}_{width}_caustic.npz')
    if file and os.path.exists(file):
        sums.load(file, scene['sha256'])
    end = time.time() + seconds
    while time.time() < end or sums.n < 8:
        t = time.time()
        image = tracer.caustic_pass(sums.seed, 2 ** 20)[:, None]
        sums.add(image, 2 ** 20 / (w * h), time.time() - t)
    if file:
        sums.save(file, scene['sha256'])
    return sums


def light_sums(scene, width, seconds, state):
    """Light tracing: everything whose first surface from the eye is diffuse or emissive."""
    world = mitsuba_scene(scene, width)
    integrator = mi.load_dict({'type': 'ptracer', 'max_depth': -1, 'rr_depth': 12})
    w, h = resolution(scene, width)
    sums = Sums(w * h)
    file = state and os.path.join(state, f'{scene["name"]}_{width}_light.npz')
    if file and os.path.exists(file):
        sums.load(file, scene['sha256'])
    end, spp = time.time() + seconds, max(1, 2 ** 20 // (w * h))
    while time.time() < end or sums.n < 4:
        t = time.time()
        image = np.array(mi.render(world, integrator=integrator, spp=spp, seed=10_000 + sums.seed), np.float64).reshape(w * h, 1, 3)
        sums.add(np.concatenate([image, 0 * image], -1), spp, time.time() - t)
    if file:
        sums.save(file, scene['sha256'])
    return sums


def sky_image(scene, width, sky, spp=4096):
    """A convex body under a uniform sky: radiance = reflectance x sky; only the coverage of edge pixels is sampled."""
    tracer = PathTracer(scene, width)
    w, h = tracer.size
    sums = Sums(w * h)
    batches = 2 ** 21 // (w * h * BATCH)
    while sums.spp < spp:
        n = w * h * batches * BATCH
        pixel = dr.arange(mi.UInt32, n) // (batches * BATCH)
        rng = mi.PCG32(size=n, initstate=dr.opaque(mi.UInt64, 77 + sums.seed))
        x, y = (mi.Float(pixel % w) + rng.next_float32()) / w, (mi.Float(pixel // w) + rng.next_float32()) / h
        ray, _ = tracer.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
        si = tracer.world.ray_intersect(ray)
        rho = tracer.look_up(tracer.base, dr.reinterpret_array(mi.UInt32, si.shape), si.is_valid())
        L = dr.select(si.is_valid(), rho, 1) * mi.Color3f(*sky)
        out = np.stack([np.array(dr.block_sum(v, BATCH) / BATCH, np.float64) for v in L], -1).reshape(w * h, batches, 3)
        sums.add(np.concatenate([out, 0 * out], -1), batches * BATCH, 0)
    return sums


# --------------------------------------------------------------------------------------------------------------- files

def round_bits(x, bits):
    """float32 rounded to `bits` significant bits"""
    m, e = np.frexp(np.asarray(x, np.float64))
    return np.ldexp(np.round(np.ldexp(m, bits)), e - bits).astype(np.float32)


def round_to_noise(x, se):
    """float32 rounded to a power of two of at most se / 8, and to 12 significant bits"""
    step = np.exp2(np.floor(np.log2(np.maximum(se, 1e-30) / 8)))
    return round_bits(np.where(se > 0, np.round(x / step) * step, x), 12)


def box5(x):
    p = np.pad(x, 2, mode='edge')
    return sum(p[i:i + x.shape[0], j:j + x.shape[1]] for i in range(5) for j in range(5)) / 25


def caustic_mask(image, caustic):
    """1 where the caustic's share of the smoothed luminance is above MASK_SHARE"""
    a, b = box5(caustic @ LUM), box5(image @ LUM)
    return ((a > MASK_SHARE * b) & (b > 1e-3 * b.mean())).astype(np.float32)


def write_exr(path, image, se, mask=None, exact=False):
    import OpenEXR
    channels = {}
    for k, c in enumerate('RGB'):
        channels[c] = np.ascontiguousarray(image[..., k].astype(np.float32) if exact else round_to_noise(image[..., k], se[..., k]))
        channels[f'SE.{c}'] = np.ascontiguousarray(round_bits(se[..., k], 5))
    if mask is not None:
        channels['mask'] = np.ascontiguousarray(mask, np.float32)
    header = {'compression': OpenEXR.ZIP_COMPRESSION, 'type': OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as f:
        f.write(path)


def read_exr(path):
    import OpenEXR
    with OpenEXR.File(path, separate_channels=True) as f:
        c = {k: np.asarray(v.pixels) for k, v in f.channels().items()}
    pick = lambda p: np.stack([c[p + k] for k in 'RGB'], -1)
    return pick(''), pick('SE.'), c.get('mask')


def noise_summary(image, se):
    lum, err = image @ LUM, np.sqrt(se.astype(float) ** 2 @ LUM ** 2)
    lit = lum > 1e-6 * max(lum.max(), 1e-30)
    rel = err[lit] / lum[lit]
    return dict(mean_relative=float(rel.mean()), median_relative=float(np.median(rel)),
                p95_relative=float(np.percentile(rel, 95)),
                noise_relMSE=float((se.astype(float) ** 2 / (image.astype(float) ** 2 + 0.01)).mean()))


def certificate(name, scene_sha256, image, se, **fields):
    lum = image @ LUM
    limits = SETTINGS.get(name, {}).get('limits', GLASS)
    return dict(scene=f'scenes/{name}.glb', scene_sha256=scene_sha256, **fields,
                resolution=[image.shape[1], image.shape[0]], filter='box',
                standard_error=noise_summary(image, se), mean_luminance=float(lum.mean()),
                lit_fraction=float((lum > 1e-6 * lum.max()).mean()), licence='CC0-1.0', quality='standard',
                limits=dict(max=limits), **(dict(mask_limits=dict(max=MASK)) if limits in (RING, GLASS) else {}))


def save_png(path, image, exposure=None):
    """A look, not a reference: sRGB with a soft shoulder, 95th percentile of the luminance at 0.8."""
    from PIL import Image
    lum = image @ LUM
    x = np.maximum(image, 0) * (exposure or 0.8 / max(np.percentile(lum[lum > 1e-6], 95) if (lum > 1e-6).any() else 1, 1e-6))
    x = np.where(x < 0.6, x, 0.6 + 0.4 * (1 - np.exp(-(x - 0.6) / 0.4)))
    x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    Image.fromarray((x * 255 + 0.5).clip(0, 255).astype(np.uint8)).save(path)


def make(path, args):
    scene = load_glb(path)
    name, s = scene['name'], SETTINGS.get(scene['name'], {})
    s = dict(s, **json.loads(args.settings))
    check_winding(scene)
    w, h = resolution(scene, args.width)
    shaped = lambda x: x.reshape(h, w, -1)
    start, fields, mask, caustic = time.time(), {}, None, None
    renderer = dict(name='Mitsuba', version=mi.__version__, variant=mi.variant())
    if s.get('exact') == 'furnace':
        m = next(m['material'] for m in scene['meshes'] if m['material']['emission'].max() > 0)
        image = np.broadcast_to(m['emission'] / (1 - m['base']), (h, w, 3))
        se = np.zeros((h, w, 3))
        fields = dict(renderer=dict(name='analytic'), method='every surface emits L and reflects rho, the object is lossless: L / (1 - rho)')
    else:
        if 'sky' in s:
            sums = sky_image(scene, args.width, s['sky'])
            fields = dict(method='reflectance x sky radiance; edge pixels by sampled coverage', sky=s['sky'])
        else:
            share = {'all': 0.5, 'caustics': 0.05}.get(s.get('light_tracing'), 0)
            sums = path_sums(scene, args.width, args.seconds * (1 - share), args.state, s)
            fields = dict(method='path tracing; emitters sampled directly and through planar mirrors (see make_reference.py)',
                          planar_chains=s.get('chains', 0), panes=s.get('panes', 0))
        mean, var = sums.mean(), sums.variance()
        image, caustic = mean[:, :3], mean[:, 3:]
        if s.get('light_tracing') == 'caustics':
            lights = caustic_sums(scene, args.width, args.seconds * share, args.state, s)
            image, var, caustic = image + lights.mean()[:, :3], var + lights.variance(), caustic + lights.mean()[:, 3:]
            fields.update(method=fields['method'] + '; light by way of curved mirrors and glass by light tracing', light_tracing_paths=lights.n * 2 ** 20,
                          light_tracing_seconds=round(lights.seconds, 1))
        if s.get('light_tracing') == 'all':
            lights = light_sums(scene, args.width, args.seconds * share, args.state)
            image, var = image + lights.mean()[:, :3], var + lights.variance()
            if any(map(makes_caustics, scene['meshes'])):
                black = light_sums(without_caustics(scene), args.width, args.seconds * 0.1, args.state)
                caustic = caustic + np.maximum(lights.mean() - black.mean(), 0)[:, :3]
            fields.update(method='light tracing (Mitsuba ptracer) where the first surface from the eye is diffuse or emissive, path '
                                 'tracing where it is a mirror or glass', light_tracing_spp=lights.spp, light_tracing_seconds=round(lights.seconds, 1))
        image, se = shaped(image), shaped(np.sqrt(var))
        fields.update(renderer=renderer, samples_per_pixel=sums.spp, samples=sums.spp * w * h, passes=sums.seed, seed=0, seconds=round(sums.seconds, 1))
        if any(map(makes_caustics, scene['meshes'])) and caustic is not None:
            mask = caustic_mask(image, shaped(caustic))
            fields['mask'] = dict(share=MASK_SHARE, smoothing='5x5', fraction=float(mask.mean()))
    if args.png:
        os.makedirs(args.png, exist_ok=True)
        save_png(os.path.join(args.png, name + '.png'), np.asarray(image), args.exposure)
        if mask is not None:
            save_png(os.path.join(args.png, name + '_mask.png'), np.asarray(image) * (0.25 + 0.75 * mask[..., None]), args.exposure)
    if args.mask_only:
        old, old_se, _ = read_exr(args.mask_only)
        z = (old - image) / np.sqrt(old_se ** 2 + se ** 2 + 1e-12)
        print(f'{name}: against {args.mask_only}: luminance ratio {(image @ LUM).mean() / (old @ LUM).mean():.5f}, rms z {np.sqrt((z ** 2).mean()):.3f}')
        write_exr(args.mask_only, old, old_se, mask)
        side = os.path.splitext(args.mask_only)[0] + '.json'
        doc = json.load(open(side))
        doc['mask'] = fields['mask']
        json.dump(doc, open(side, 'w'), indent=1)
        return
    if not args.look:
        write_exr(os.path.join(args.out, name + '.exr'), image, se, mask, exact='exact' in s)
        doc = certificate(name, scene['sha256'], np.asarray(image), se, **fields)
        json.dump(doc, open(os.path.join(args.out, name + '.json'), 'w'), indent=1)
    tris = sum(len(m['F']) for m in scene['meshes'])
    noise = noise_summary(np.asarray(image), se)
    print(f'{name}: {tris} triangles, {fields.get("samples_per_pixel", 0)} spp, {time.time() - start:.0f} s, mean relative SE {noise["mean_relative"]:.4f}, '
          f'p95 {noise["p95_relative"]:.4f}, relMSE {noise["noise_relMSE"]:.2e}, mean luminance {(np.asarray(image) @ LUM).mean():.4f}', flush=True)


if __name__ == '__main__':
    ap = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    ap.add_argument('scenes', nargs='+')
    ap.add_argument('--seconds', type=float, default=60, help='time per scene')
    ap.add_argument('--out', default=os.path.dirname(os.path.abspath(__file__)))
    ap.add_argument('--state', help='folder that keeps the sums, so that a later run adds to them')
    ap.add_argument('--width', type=int, default=WIDTH)
    ap.add_argument('--png', help='folder for tone-mapped pictures')
    ap.add_argument('--exposure', type=float, help='of the PNG')
    ap.add_argument('--look', action='store_true', help='write no reference')
    ap.add_argument('--mask-only', metavar='EXR', help='only add the caustic mask to an existing reference')
    ap.add_argument('--settings', default='{}', help='JSON that overrides the settings of the scene')
    a = ap.parse_args()
    if a.state:
        os.makedirs(a.state, exist_ok=True)
    start_mitsuba()
    for p in a.scenes:
        make(p, a)
