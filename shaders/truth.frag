#version 450 core
// One eye's disparity from its planar depth. VISIBILITY: whether the other eye sees the same point. INSTANCES: ids.
//
// Visibility takes three draws of this pass, each for the pixels that the one before discarded, which a depth test sees
// to: most are decided by the depth maps alone; TRACE 1 follows the surfaces beside a point, and TRACE 2 those above and
// below it, which alone may show something thin that passes between two pixels.

uniform sampler2D own_depth;

#include "common_disparity.glsl"

layout(location = DISPARITY) out float disparity_px;

#if defined(VISIBILITY) || defined(INSTANCES)
uniform usampler2D own_surface;
#endif

#ifdef INSTANCES
layout(location = INSTANCES) out uint instance_id;  // 0: nothing
#endif

#ifdef VISIBILITY
uniform sampler2D other_depth;
uniform usampler2D other_surface;
uniform float other_from_own;  // -1 in the left view (x_right = x_left - d), +1 in the right one

layout(location = VISIBILITY) out uint visibility;

const uint VISIBLE = 255u;
const uint OCCLUDED = 128u;
const uint OUTSIDE = 0u;
const uint UNDECIDED = 1u;

const int ROWS[3] = int[3](0, -1, 1);

#ifdef TRACE
#include "common_silhouette.glsl"

const int FIRST_TRACED = TRACE == 1 ? 0 : 2;
const int LAST_TRACED = TRACE == 1 ? 2 : 6;

// How much nearer a surface must be to hide a point: what float32 leaves uncertain.
const float ROUNDING_PX = 1e-3;
const float ROUNDING_RELATIVE = 2e-6;

bool hides(uvec2 surface, uvec2 own, vec2 start, vec2 target) {
    if (surface == own) {
        return false;
    }
    float inverse_depth = surface_at(surface, start, target);
    float rounding_px = ROUNDING_PX + ROUNDING_RELATIVE * focal_baseline * abs(inverse_depth);
    return inverse_depth > 0.0 && focal_baseline * inverse_depth - doffs_px > disparity_px + rounding_px;
}
#endif

// Change of disparity per pixel along the row, from the side where the surface goes on: the smaller difference.
float slope_at(ivec2 pixel, float disparity, int width) {
    float before = pixel.x > 0 ? disparity - disparity_of(texelFetch(own_depth, pixel - ivec2(1, 0), 0).r) : INVALID;
    float after = pixel.x + 1 < width ? disparity_of(texelFetch(own_depth, pixel + ivec2(1, 0), 0).r) - disparity : INVALID;
    float slope = abs(before) < abs(after) ? before : after;
    return isinf(slope) || isnan(slope) ? 0.0 : slope;
}

uint visibility_of(ivec2 pixel, uvec2 own) {
    ivec2 last = textureSize(own_depth, 0) - 1;
    vec2 target = vec2(float(pixel.x) + other_from_own * disparity_px, pixel.y);
    if (isinf(disparity_px) || target.x < -0.5 || target.x >= float(last.x) + 0.5) {
        return OUTSIDE;
    }
    // The pixels of the other view around the point: beside it, above and below. At the border one stands for several.
    int left = clamp(int(floor(target.x)), 0, last.x);
    ivec2 around[6];
    uvec2 surface[6];
    bool thin = false;  // something that only the rows above and below show
    for (int k = 0; k < 6; ++k) {
        around[k] = clamp(ivec2(left + (k & 1), pixel.y + ROWS[k >> 1]), ivec2(0), last);
        surface[k] = texelFetch(other_surface, around[k], 0).rg;
        // A surface has no meaning where nothing is drawn.
        thin = thin || (k > 1 && surface[k].x != own.x && texelFetch(other_depth, around[k], 0).r > 0.0);
    }
#if !defined(TRACE) || TRACE == 1
    vec2 depth = vec2(texelFetch(other_depth, around[0], 0).r, texelFetch(other_depth, around[1], 0).r);

    // Most points are decided by what is seen on both sides. Their own surface has there the disparity that its slope
    // predicts (moving one pixel here moves 1 + other_from_own * slope pixels there), or both are clearly nearer.
    if (depth.x > 0.0 && depth.y > 0.0) {
        vec2 seen = vec2(disparity_of(depth.x), disparity_of(depth.y));
        float slope = slope_at(pixel, disparity_px, last.x + 1);
        float stretch = 1.0 + other_from_own * slope;
        float other_slope = abs(stretch) > 0.05 ? slope / stretch : 0.0;
        vec2 difference = seen - disparity_px - (vec2(around[0].x, around[1].x) - target.x) * other_slope;
        if (surface[0].x == own.x && surface[1].x == own.x &&
            all(lessThan(abs(difference), vec2(0.05 + 0.5 * abs(other_slope))))) {
            return thin ? UNDECIDED : VISIBLE;
        }
        if (all(greaterThan(difference, vec2(0.5 + abs(other_slope))))) {
            return OCCLUDED;
        }
    }
#endif
#ifdef TRACE
    for (int k = FIRST_TRACED; k < LAST_TRACED; ++k) {
        bool drawn = texelFetch(other_depth, around[k], 0).r > 0.0;
        if (drawn && hides(surface[k], own, vec2(around[k]), target)) {
            return OCCLUDED;
        }
    }
    return TRACE == 1 && thin ? UNDECIDED : VISIBLE;
#else
    return UNDECIDED;
#endif
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float depth_m = texelFetch(own_depth, pixel, 0).r;
    disparity_px = disparity_of(depth_m);
#if defined(VISIBILITY) || defined(INSTANCES)
    uvec2 own = texelFetch(own_surface, pixel, 0).rg;
#endif
#ifdef INSTANCES
    instance_id = depth_m > 0.0 ? own.x + 1u : 0u;
#endif
#ifdef VISIBILITY
    visibility = visibility_of(pixel, own);
    if (visibility == UNDECIDED) {
        discard;
    }
#endif
}
