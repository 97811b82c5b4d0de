#version 450 core
// Whether the other eye sees the point that a pixel of this eye shows.
//
// Three draws of this pass, each for the pixels that the one before discarded, which a depth test sees to: most are
// decided by the two disparity maps alone; TRACE 1 follows the surfaces beside a point, and TRACE 2 those above and
// below it, which alone may show something thin that passes between two pixels.

#include "common_constants.glsl"

layout(binding = 0) uniform sampler2D own_disparity;
layout(binding = 1) uniform sampler2D other_disparity;  // its wrap must be clamped

layout(location = 0) out uint visibility;

// Change of disparity from pixel to pixel that passes for one surface without a look at its triangles.
const float STEEPEST = 2.0;

#ifdef TRACE
#include "common_silhouette.glsl"

layout(binding = 2) uniform usampler2D own_surface;
layout(binding = 3) uniform usampler2D other_surface;

// How much nearer a surface must be to hide a point: what float32 leaves uncertain.
const float ROUNDING_PX = 1e-3;
const float ROUNDING_RELATIVE = 2e-6;

bool hides(uvec2 surface, uvec2 own, vec2 start, vec2 target, float disparity_px) {
    if (surface == own) {
        return false;
    }
    float inverse_depth = surface_at(surface, start, target);
    float rounding_px = ROUNDING_PX + ROUNDING_RELATIVE * focal_baseline * abs(inverse_depth);
    return inverse_depth > 0.0 && focal_baseline * inverse_depth - doffs_px > disparity_px + rounding_px;
}
#endif

// Which sides of a column are nearer than a surface that goes on from row to row, which is as much nearer on one side as
// it is farther on the other.
bvec2 stands_out(float above, float middle, float below) {
    float fall = middle - min(above, below);
    return greaterThan(vec2(above, below) - middle, vec2(0.5 + clamp(fall, 0.0, 2.0)));
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    ivec2 last = textureSize(own_disparity, 0) - 1;
    float disparity_px = texelFetch(own_disparity, pixel, 0).r;
    vec2 target = vec2(float(pixel.x) + other_from_own * disparity_px, pixel.y);
    if (disparity_px > LARGEST || target.x < -0.5 || target.x >= float(last.x) + 0.5) {
        visibility = OUTSIDE;
        return;
    }
    // The pixels of the other view around the point: beside it (w, z of lower), below (x, y) and above (w, z of upper).
    float left = floor(target.x);
    vec2 corner = vec2(left + 1.0, target.y + 1.0) / vec2(last + 1);
    vec4 lower = textureGather(other_disparity, corner);
    vec4 upper = textureGather(other_disparity, corner - vec2(0.0, 1.0 / float(last.y + 1)));
    lower = mix(lower, vec4(0.0), greaterThan(lower, vec4(LARGEST)));
    upper = mix(upper, vec4(0.0), greaterThan(upper, vec4(LARGEST)));
    // What stands out above or below in both columns has its edge between the rows; in one of them, it may be thin and
    // pass between the columns.
    bvec2 left_side = stands_out(upper.w, lower.w, lower.x), right_side = stands_out(upper.z, lower.z, lower.y);
    bool thin = any(notEqual(left_side, right_side));

    // Disparity is linear along the row of a plane, so the point's own surface has, between the pixels beside it, the
    // point's disparity.
    float step = abs(lower.z - lower.w);
    float between = mix(lower.w, lower.z, target.x - left);
    bool goes_on = abs(between - disparity_px) < 0.05 + 0.02 * step && step < STEEPEST;

#ifndef TRACE
    bool hidden = min(lower.w, lower.z) > disparity_px + 0.5;  // both sides are clearly nearer
    if (!hidden && (!goes_on || thin)) {
        discard;
    }
    visibility = hidden ? OCCLUDED : VISIBLE;
#else
    uvec2 own = texelFetch(own_surface, pixel, 0).rg;
    visibility = VISIBLE;
#if TRACE == 1
    // What is farther by more than a surface rises within a pixel hides nothing.
    float farthest = goes_on ? LARGEST : disparity_px - STEEPEST;
    for (int k = 0; k < 2; ++k) {
        float beside = k == 0 ? lower.w : lower.z;
        if (beside == 0.0 || beside < farthest) {
            continue;
        }
        ivec2 around = clamp(ivec2(int(left) + k, pixel.y), ivec2(0), last);
        if (hides(texelFetch(other_surface, around, 0).rg, own, vec2(around), target, disparity_px)) {
            visibility = OCCLUDED;
            break;
        }
    }
#else
    for (int k = 0; k < 2; ++k) {
        // What stands out in one of the two columns of the row above, or below.
        if (left_side[k] == right_side[k]) {
            continue;
        }
        ivec2 to = ivec2(left_side[k] ? 0 : 1, k == 0 ? -1 : 1);
        ivec2 around = clamp(ivec2(int(left), pixel.y) + to, ivec2(0), last);
        if (hides(texelFetch(other_surface, around, 0).rg, own, vec2(around), target, disparity_px)) {
            visibility = OCCLUDED;
            break;
        }
    }
#endif
    if (TRACE == 1 && thin && visibility == VISIBLE) {
        discard;
    }
#endif
}
