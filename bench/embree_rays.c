/* Embree's side of against_embree.py: a loop of rtcIntersect1 over an array of rays, compiled by the script.
 *
 * Only the few declarations that are needed, by the headers of Embree 4 (rtcore_common.h, rtcore_ray.h, rtcore_device.h, rtcore_scene.h,
 * rtcore_geometry.h, rtcore_buffer.h; Apache-2.0): the library comes from a Python package without headers. */

#include <math.h>
#include <stddef.h>

typedef struct RTCDeviceTy* RTCDevice;
typedef struct RTCSceneTy* RTCScene;
typedef struct RTCGeometryTy* RTCGeometry;

enum { TRIANGLES = 0, BUFFER_INDEX = 0, BUFFER_VERTEX = 1, FORMAT_UINT3 = 0x5003, FORMAT_FLOAT3 = 0x9003, SCENE_ROBUST = 4, QUALITY_HIGH = 2 };

struct __attribute__((aligned(16))) RTCRayHit {
    float org_x, org_y, org_z, tnear, dir_x, dir_y, dir_z, time, tfar;
    unsigned mask, id, flags;
    float Ng_x, Ng_y, Ng_z, u, v;
    unsigned primID, geomID, instID, instPrimID;
};

RTCDevice rtcNewDevice(const char*);
RTCScene rtcNewScene(RTCDevice);
RTCGeometry rtcNewGeometry(RTCDevice, int);
void rtcSetSharedGeometryBuffer(RTCGeometry, int, unsigned, int, const void*, size_t, size_t, size_t);
void rtcCommitGeometry(RTCGeometry);
unsigned rtcAttachGeometry(RTCScene, RTCGeometry);
void rtcReleaseGeometry(RTCGeometry);
void rtcSetSceneFlags(RTCScene, int);
void rtcSetSceneBuildQuality(RTCScene, int);
void rtcCommitScene(RTCScene);
int rtcGetSceneFlags(RTCScene);
int rtcGetDeviceError(RTCDevice);
void rtcIntersect1(RTCScene, struct RTCRayHit*, void*);

/* The scene of `count` triangles; NULL if anything failed. `vertices` has 3 per triangle and 4 bytes of room behind its end. */
RTCScene make_scene(const float* vertices, const unsigned* indices, size_t count, int robust)
{
    RTCDevice device = rtcNewDevice(NULL);
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, TRIANGLES);
    rtcSetSharedGeometryBuffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, vertices, 0, 12, 3 * count);
    rtcSetSharedGeometryBuffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, indices, 0, 12, count);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcSetSceneFlags(scene, robust ? SCENE_ROBUST : 0);
    rtcSetSceneBuildQuality(scene, QUALITY_HIGH);
    rtcCommitScene(scene);
    int robust_is_on = (rtcGetSceneFlags(scene) & SCENE_ROBUST) != 0;
    return rtcGetDeviceError(device) == 0 && robust_is_on == (robust != 0) ? scene : NULL;
}

/* Distances of the nearest hits of rays (origin, direction). */
void trace(RTCScene scene, const float* rays, float* hits, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const float* r = rays + 6 * i;
        struct RTCRayHit q = { r[0], r[1], r[2], 0.0f, r[3], r[4], r[5], 0.0f, INFINITY, ~0u, 0, 0, 0, 0, 0, 0, 0, ~0u, ~0u, ~0u, ~0u };
        rtcIntersect1(scene, &q, NULL);
        hits[i] = q.geomID == ~0u ? INFINITY : q.tfar;
    }
}
