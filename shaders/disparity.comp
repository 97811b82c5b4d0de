#version 450 core
// The disparity of a view from its 1 / Z: a view that several cameras share is drawn once, and each has its own f B.

#include "common_constants.glsl"
#include "common_disparity.glsl"

layout(local_size_x = 16, local_size_y = 4) in;

layout(binding = 0) uniform sampler2D inverse_depth;  // negative where nothing is drawn

layout(binding = 0, r32f) writeonly uniform image2D disparity;

uniform uvec4 part;  // left column, first row, width and height

void main() {
    if (any(greaterThanEqual(gl_GlobalInvocationID.xy, part.zw))) {
        return;
    }
    ivec2 pixel = ivec2(part.xy + gl_GlobalInvocationID.xy);
    float nearness = texelFetch(inverse_depth, pixel, 0).r;
    imageStore(disparity, pixel, vec4(nearness < 0.0 ? INVALID : disparity_at(nearness)));
}
