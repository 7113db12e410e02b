/* Embree 3 as `dynrt compare` drives it: one triangle mesh, built or refitted, and rays cast at it one by one or by four.
 *
 * src/compare/embree.rs compiles this file into a shared library and calls the functions below, so that both sides of the
 * comparison run in one process and take turns. Nothing is measured here: the caller times dynrt_commit and dynrt_cast.
 */

#include <embree3/rtcore.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(__SSE__)
#include <immintrin.h>
#endif

/* Both as in src/compare/embree.rs. */
struct dynrt_ray {
    float origin[3], tmin;
    float direction[3], tmax;
    unsigned active;
};

/* The triangle is RTC_INVALID_GEOMETRY_ID, all ones, for a miss. */
struct dynrt_hit {
    float t, u, v;
    unsigned triangle;
};

struct dynrt_mesh {
    RTCDevice device;
    RTCScene scene;
    RTCGeometry geometry;
    float *vertices;
    size_t vertex_count;
};

/* A device that builds on one core; NULL if there is none. */
void *dynrt_open(void) {
    return rtcNewDevice("threads=1");
}

void dynrt_close(void *device) {
    rtcReleaseDevice((RTCDevice)device);
}

/* Major · 10000 + minor · 100 + patch. */
long dynrt_version(void *device) {
    return (long)rtcGetDeviceProperty((RTCDevice)device, RTC_DEVICE_PROPERTY_VERSION);
}

/* The first error of the calling thread since its last call, 0 for none. */
int dynrt_error(void *device) {
    return (int)rtcGetDeviceError((RTCDevice)device);
}

static void free_mesh(struct dynrt_mesh *mesh) {
    rtcReleaseGeometry(mesh->geometry);
    rtcReleaseScene(mesh->scene);
    free(mesh);
}

/* A mesh that is not built yet: dynrt_commit does that. If it moves, commits after the first
 * refit. Vertices are three numbers each, triangles three indices. NULL if memory is short. */
void *dynrt_mesh(void *device, const float *vertices, size_t vertex_count, const unsigned *triangles,
                 size_t triangle_count, int moves) {
    struct dynrt_mesh *mesh = calloc(1, sizeof *mesh);
    if (!mesh)
        return NULL;
    mesh->device = (RTCDevice)device;
    mesh->vertex_count = vertex_count;
    mesh->scene = rtcNewScene(mesh->device);
    mesh->geometry = rtcNewGeometry(mesh->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    mesh->vertices = rtcSetNewGeometryBuffer(mesh->geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                             3 * sizeof(float), vertex_count);
    unsigned *indices = rtcSetNewGeometryBuffer(mesh->geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                3 * sizeof(unsigned), triangle_count);
    if (!mesh->vertices || !indices) {
        free_mesh(mesh);
        return NULL;
    }
    memcpy(mesh->vertices, vertices, 3 * sizeof(float) * vertex_count);
    memcpy(indices, triangles, 3 * sizeof(unsigned) * triangle_count);
    rtcSetSceneFlags(mesh->scene, moves ? RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_DYNAMIC : RTC_SCENE_FLAG_ROBUST);
    if (moves) {
        /* A geometry's quality counts only in scenes of low quality, which have an index for each geometry. */
        rtcSetSceneBuildQuality(mesh->scene, RTC_BUILD_QUALITY_LOW);
        rtcSetGeometryBuildQuality(mesh->geometry, RTC_BUILD_QUALITY_REFIT);
    }
    rtcCommitGeometry(mesh->geometry);
    rtcAttachGeometry(mesh->scene, mesh->geometry);
    return mesh;
}

void dynrt_free(void *mesh) {
    free_mesh(mesh);
}

/* Hands over vertices that have moved, as many as there were; dynrt_commit refits. */
void dynrt_move(void *handle, const float *vertices) {
    struct dynrt_mesh *mesh = handle;
    memcpy(mesh->vertices, vertices, 3 * sizeof(float) * mesh->vertex_count);
    rtcUpdateGeometryBuffer(mesh->geometry, RTC_BUFFER_TYPE_VERTEX, 0);
    rtcCommitGeometry(mesh->geometry);
}

/* Builds, or refits. */
void dynrt_commit(void *mesh) {
    rtcCommitScene(((struct dynrt_mesh *)mesh)->scene);
}

static void cast_one(RTCScene scene, const struct dynrt_ray *ray, struct dynrt_hit *hit) {
    struct RTCIntersectContext context;
    struct RTCRayHit query;
    *hit = (struct dynrt_hit){INFINITY, 0, 0, RTC_INVALID_GEOMETRY_ID};
    if (!ray->active)
        return;
    rtcInitIntersectContext(&context);
    query.ray.org_x = ray->origin[0];
    query.ray.org_y = ray->origin[1];
    query.ray.org_z = ray->origin[2];
    query.ray.dir_x = ray->direction[0];
    query.ray.dir_y = ray->direction[1];
    query.ray.dir_z = ray->direction[2];
    query.ray.tnear = ray->tmin;
    query.ray.tfar = ray->tmax;
    query.ray.time = 0;
    query.ray.mask = ~0u;
    query.ray.id = 0;
    query.ray.flags = 0;
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    query.hit.primID = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(scene, &context, &query);
    if (query.hit.geomID != RTC_INVALID_GEOMETRY_ID)
        *hit = (struct dynrt_hit){query.ray.tfar, query.hit.u, query.hit.v, query.hit.primID};
}

/* Up to four rays. */
static void cast_four(RTCScene scene, const struct dynrt_ray *rays, struct dynrt_hit *hits, size_t count) {
    struct RTCIntersectContext context;
    struct RTCRayHit4 query;
    RTC_ALIGN(16) int valid[4];
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    for (size_t k = 0; k < 4; k++) {
        const struct dynrt_ray *ray = &rays[k < count ? k : 0];
        valid[k] = k < count && ray->active ? -1 : 0;
        query.ray.org_x[k] = ray->origin[0];
        query.ray.org_y[k] = ray->origin[1];
        query.ray.org_z[k] = ray->origin[2];
        query.ray.dir_x[k] = ray->direction[0];
        query.ray.dir_y[k] = ray->direction[1];
        query.ray.dir_z[k] = ray->direction[2];
        query.ray.tnear[k] = ray->tmin;
        query.ray.tfar[k] = ray->tmax;
        query.ray.time[k] = 0;
        query.ray.mask[k] = ~0u;
        query.ray.id[k] = 0;
        query.ray.flags[k] = 0;
        query.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
        query.hit.primID[k] = RTC_INVALID_GEOMETRY_ID;
        query.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
    }
    rtcIntersect4(valid, scene, &context, &query);
    for (size_t k = 0; k < count; k++) {
        hits[k] = (struct dynrt_hit){INFINITY, 0, 0, RTC_INVALID_GEOMETRY_ID};
        if (valid[k] && query.hit.geomID[k] != RTC_INVALID_GEOMETRY_ID)
            hits[k] = (struct dynrt_hit){query.ray.tfar[k], query.hit.u[k], query.hit.v[k], query.hit.primID[k]};
    }
}

/* Casts rays at a mesh that has been committed, one by one or by four, and returns as dynrt_error does. May be called by
 * several threads at once. */
int dynrt_cast(void *handle, const struct dynrt_ray *rays, struct dynrt_hit *hits, size_t count, int by_four) {
    const struct dynrt_mesh *mesh = handle;
    RTCScene scene = mesh->scene;
#if defined(__SSE__)
    /* As Embree's manual asks for; the caller's mode is restored, since the golden model wants IEEE arithmetic. */
    unsigned mode = _mm_getcsr();
    _mm_setcsr(mode | 0x8040); /* flush results to zero, take subnormal operands for zero */
#endif
    if (by_four)
        for (size_t k = 0; k < count; k += 4)
            cast_four(scene, rays + k, hits + k, count - k < 4 ? count - k : 4);
    else
        for (size_t k = 0; k < count; k++)
            cast_one(scene, rays + k, hits + k);
#if defined(__SSE__)
    _mm_setcsr(mode);
#endif
    return dynrt_error(mesh->device);
}
