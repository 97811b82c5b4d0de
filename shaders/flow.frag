#version 450 core
// Where the point that a pixel of one eye shows is at another moment, seen by the same eye, and whether it is seen then.
//
// Two draws of this pass: most pixels are decided by the depth map of the other moment alone; TRACE, for those that the
// first discards, follows the surfaces around the point to it.

#include "common_constants.glsl"
#include "common_disparity.glsl"
#include "common_silhouette.glsl"

layout(binding = 0) uniform sampler2D own_depth;       // m; inf where nothing is drawn
layout(binding = 1) uniform usampler2D own_surface;
layout(binding = 2) uniform sampler2D then_depth;      // its wrap must be clamped
layout(binding = 3) uniform usampler2D then_surface;

struct Move {
    vec4 turn_and_shift_x;   // rows of R - 1 and of the shift of the centre: a point at c + q goes to c + shift + R q
    vec4 turn_and_shift_y;
    vec4 turn_and_shift_z;
    vec4 centre;             // c, relative to this eye
    uvec4 then;              // the instance then, or GONE
};

layout(std430, binding = 4) readonly buffer Moves { Move moves[]; };

layout(location = FLOW) out vec2 flow_px;
layout(location = DISPARITY_CHANGE) out float disparity_change_px;
layout(location = FLOW_VISIBILITY) out uint visibility;

const uint GONE = 0xFFFFFFFFu;
// What float32 leaves uncertain of 1 / Z.
const float ROUNDING = 2e-5;
// What a surface may bend between four pixels that all show it.
const float BEND = 2e-4;
// Nearer by this share is nearer, whatever the surface does between two pixels.
const float CLEARLY = 0.01;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    ivec2 last = textureSize(own_depth, 0) - 1;
    float depth_m = texelFetch(own_depth, pixel, 0).r;
    flow_px = vec2(INVALID);
    disparity_change_px = INVALID;
    visibility = OUTSIDE;
    if (depth_m > LARGEST) {
        return;
    }
    uvec2 own = texelFetch(own_surface, pixel, 0).rg;
    Move move = moves[own.x];
    // All lengths in units of the depth. The displacement is worked out as such, not as the difference of two places:
    // so its rounding errors are of its own size.
    float inverse_depth = 1.0 / depth_m;
    vec3 ray = vec3((vec2(pixel) - centre_px) / focal_px, 1.0);
    vec4 from_centre = vec4(ray - move.centre.xyz * inverse_depth, inverse_depth);
    vec3 way = vec3(dot(move.turn_and_shift_x, from_centre), dot(move.turn_and_shift_y, from_centre),
                    dot(move.turn_and_shift_z, from_centre));
    float growth = 1.0 + way.z;  // depth then, in units of the depth now
    if (growth * depth_m < near_m) {
        return;
    }
    flow_px = focal_px * (way.xy - ray.xy * way.z) / growth;
    float inverse_depth_then = inverse_depth / growth;
    if (disparity_at(inverse_depth) < LARGEST && disparity_at(inverse_depth_then) < LARGEST) {
        disparity_change_px = -focal_baseline * inverse_depth * way.z / growth;
    }

    vec2 target = vec2(pixel) + flow_px;
    if (any(lessThan(target, vec2(-0.5))) || any(greaterThanEqual(target, vec2(last) + 0.5))) {
        return;
    }
    visibility = OCCLUDED;
    if (move.then.x == GONE) {
        return;
    }
    // The four pixels around the point then: x, y are below, left and right, and w, z above.
    vec2 corner = (floor(target) + 1.0) / vec2(last + 1);
    vec4 nearness = 1.0 / textureGather(then_depth, corner);
    float nearest = max(max(nearness.x, nearness.y), max(nearness.z, nearness.w));
    float farthest = min(min(nearness.x, nearness.y), min(nearness.z, nearness.w));
#ifndef TRACE
    uvec4 around = textureGather(then_surface, corner, 0);
    vec2 between = fract(target);
    float expected = mix(mix(nearness.w, nearness.z, between.x), mix(nearness.x, nearness.y, between.x), between.y);
    bool goes_on = all(equal(around, uvec4(move.then.x))) && nearest - farthest < CLEARLY * nearest
        && abs(expected - inverse_depth_then) < BEND * inverse_depth_then;
    bool hidden = farthest > (1.0 + CLEARLY) * inverse_depth_then;
    if (!goes_on && !hidden) {
        discard;
    }
    visibility = hidden ? OCCLUDED : VISIBLE;
#else
    visibility = VISIBLE;
    const ivec2 STEPS[4] = ivec2[4](ivec2(0, 1), ivec2(1, 1), ivec2(1, 0), ivec2(0, 0));
    for (int k = 0; k < 4; ++k) {
        // What is farther by more than a surface rises within a pixel hides nothing.
        if (nearness[k] * (1.0 + 2.0 * CLEARLY) < inverse_depth_then) {
            continue;
        }
        ivec2 beside = clamp(ivec2(floor(target)) + STEPS[k], ivec2(0), last);
        uvec2 surface = texelFetch(then_surface, beside, 0).rg;
        if (surface != uvec2(move.then.x, own.y)
            && surface_at(surface, vec2(beside), target) > (1.0 + ROUNDING) * inverse_depth_then) {
            visibility = OCCLUDED;
            break;
        }
    }
#endif
}
