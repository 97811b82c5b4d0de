#version 450 core
// Disparity from a planar depth attachment, 0 where nothing was drawn. Only benchmarks/alternatives.py draws with it.

layout(binding = 0) uniform sampler2D depth_m;

#include "common_constants.glsl"
#include "common_disparity.glsl"

layout(location = 0) out float disparity_px;

void main() {
    float planar_m = texelFetch(depth_m, ivec2(gl_FragCoord.xy), 0).r;
    disparity_px = planar_m > 0.0 ? disparity_at(1.0 / planar_m) : INVALID;
}
