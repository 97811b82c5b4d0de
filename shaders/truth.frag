#version 450 core
// One eye's disparity, and whether the other eye sees the same point, from both eyes' planar depth.

uniform sampler2D own_depth;
uniform sampler2D other_depth;
uniform float other_from_own;  // -1 in the left view (x_right = x_left - d), +1 in the right one

#include "common_disparity.glsl"

layout(location = 0) out float disparity_px;
layout(location = 1) out uint visibility;

const uint VISIBLE = 255u;
const uint OCCLUDED = 128u;
const uint OUTSIDE = 0u;

// Change of disparity per pixel along the row, from the side where the surface goes on: the smaller difference.
float slope_at(ivec2 pixel, float disparity, int width) {
    float before = pixel.x > 0 ? disparity - disparity_of(texelFetch(own_depth, pixel - ivec2(1, 0), 0).r) : INVALID;
    float after = pixel.x + 1 < width ? disparity_of(texelFetch(own_depth, pixel + ivec2(1, 0), 0).r) - disparity : INVALID;
    float slope = abs(before) < abs(after) ? before : after;
    return isinf(slope) || isnan(slope) ? 0.0 : slope;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int width = textureSize(own_depth, 0).x;
    disparity_px = disparity_of(texelFetch(own_depth, pixel, 0).r);
    visibility = OUTSIDE;
    if (isinf(disparity_px)) {
        return;
    }
    float x = float(pixel.x) + other_from_own * disparity_px;
    int nearest = int(floor(x + 0.5));
    if (nearest < 0 || nearest >= width) {
        return;
    }
    // The same surface has, at the other view's pixel, the disparity that its slope predicts: moving one pixel here
    // moves 1 + other_from_own * slope pixels there.
    float slope = slope_at(pixel, disparity_px, width);
    float stretch = 1.0 + other_from_own * slope;
    float other_slope = abs(stretch) > 0.05 ? slope / stretch : 0.0;
    float tolerance_px = 0.1 + 0.5 * abs(other_slope);
    float seen = disparity_of(texelFetch(other_depth, ivec2(nearest, pixel.y), 0).r);
    float expected = disparity_px + (float(nearest) - x) * other_slope;
    // Something nearer hides the point; something farther means that the point's surface ends between two pixels.
    visibility = !isinf(seen) && seen > expected + tolerance_px ? OCCLUDED : VISIBLE;
}
