#version 450 core
// One eye's disparity from its planar depth. VISIBILITY: whether the other eye sees the same point. INSTANCES: ids.
//
// Visibility takes two draws of this pass. Most pixels are decided by the depth maps alone; the first draw discards the
// others, and the second, with TRACE, follows surfaces for them. A depth test keeps it from the pixels that are decided.

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

#ifdef TRACE
#include "common_silhouette.glsl"

// How much nearer a surface must be to hide a point: what float32 leaves uncertain.
const float ROUNDING_PX = 1e-3;
const float ROUNDING_RELATIVE = 2e-6;

bool hides(uvec2 surface, uvec2 own, float row, float start_x, float x) {
    if (surface == own) {
        return false;
    }
    float inverse_depth = surface_at(surface, row, start_x, x);
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
    int width = textureSize(own_depth, 0).x;
    float x = float(pixel.x) + other_from_own * disparity_px;
    if (isinf(disparity_px) || x < -0.5 || x >= float(width) - 0.5) {
        return OUTSIDE;
    }
    // What the other view shows on both sides of the point; at the image's border one pixel stands for both.
    int left = clamp(int(floor(x)), 0, width - 1);
    int right = min(left + 1, width - 1);
    float depth[2] = float[2](texelFetch(other_depth, ivec2(left, pixel.y), 0).r, texelFetch(other_depth, ivec2(right, pixel.y), 0).r);
    uvec2 surface[2] = uvec2[2](texelFetch(other_surface, ivec2(left, pixel.y), 0).rg, texelFetch(other_surface, ivec2(right, pixel.y), 0).rg);
    float seen[2] = float[2](disparity_of(depth[0]), disparity_of(depth[1]));

    // Most points lie within their own surface there: the same instance on both sides, with the disparity that the slope
    // predicts. Moving one pixel here moves 1 + other_from_own * slope pixels there.
    if (depth[0] > 0.0 && depth[1] > 0.0 && surface[0].x == surface[1].x) {
        float slope = slope_at(pixel, disparity_px, width);
        float stretch = 1.0 + other_from_own * slope;
        float other_slope = abs(stretch) > 0.05 ? slope / stretch : 0.0;
        vec2 expected = disparity_px + (vec2(left, right) - x) * other_slope;
        vec2 difference = vec2(seen[0], seen[1]) - expected;
        if (surface[0].x == own.x) {
            if (all(lessThan(abs(difference), vec2(0.05 + 0.5 * abs(other_slope))))) {
                return VISIBLE;
            }
        } else if (all(greaterThan(difference, vec2(2.0)))) {
            return OCCLUDED;
        }
    }
#ifdef TRACE
    bool hidden = (depth[0] > 0.0 && hides(surface[0], own, float(pixel.y), float(left), x)) ||
                  (depth[1] > 0.0 && hides(surface[1], own, float(pixel.y), float(right), x));
    return hidden ? OCCLUDED : VISIBLE;
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
