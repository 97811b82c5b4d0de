#version 450 core
// Variants of a pixel's disparity that mesh.frag does not offer, for benchmarks/alternatives.py. LINEAR writes planar
// depth, for variant_depth.frag; PLANE64 writes disparity; without both, only the depth buffer is filled.

in float view_depth_m;
flat in int scene_instance;
flat in int scene_triangle;

#if defined(LINEAR)
layout(location = 0) out float depth_m;

void main() {
    depth_m = view_depth_m;
}
#elif defined(PLANE64)
#include "common_constants.glsl"
#include "common_disparity.glsl"

layout(location = 0) out float disparity_px;

#include "common_triangles.glsl"

layout(std430, binding = 4) readonly buffer Poses { dvec4 view_from_model_row[]; };  // three of each instance

layout(std140, binding = 1) uniform Camera64 {
    dvec2 centre_px_64;
    double focal_px_64;
    double focal_baseline_64;
    double doffs_px_64;
};

dvec3 corner_64(uint triangle, int k) {
    dvec4 position = dvec4(position_of(corner_bits(triangle, k)));
    int row = 3 * scene_instance;
    return dvec3(dot(view_from_model_row[row], position), dot(view_from_model_row[row + 1], position),
                 dot(view_from_model_row[row + 2], position));
}

void main() {
    uint triangle = uint(scene_triangle);
    dvec3 a = corner_64(triangle, 0), b = corner_64(triangle, 1), c = corner_64(triangle, 2);
    dvec3 normal = cross(b - a, c - a);
    dvec3 ray = dvec3((dvec2(gl_FragCoord.xy) - 0.5 - centre_px_64) / focal_px_64, 1.0);
    double exact_px = focal_baseline_64 * dot(normal, ray) / dot(normal, a) - doffs_px_64;
    disparity_px = exact_px > 0.0 ? float(exact_px) : INVALID;
}
#else
void main() {
}
#endif
