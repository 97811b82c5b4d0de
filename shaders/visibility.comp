#version 450 core
// Whether the other eye sees the point that a pixel of this eye shows.
//
// TILES judges 4 x 4 pixels at a time by the two disparity maps, and lists the tiles that are not wholly visible. FILL
// writes tiles whose pixels all have one value. PIXELS judges the pixels of mixed tiles, and lists the undecided
// pixels. TRACE walks from the neighbouring pixels across their triangles to the point of an undecided pixel. A pixel
// that no step writes is VISIBLE. So is a point that is hidden only by surfaces that no pixel of the other view shows.
// Work lists keep the costly steps dense: llvmpipe runs eight invocations at a time through both sides of every branch.

#include "common_constants.glsl"

#define TILES 0
#define FILL 1
#define PIXELS 2
#define TRACE 3

#if STEP == TILES
layout(local_size_x = 16, local_size_y = 4) in;
#else
layout(local_size_x = 64) in;
#endif

layout(binding = 0) uniform sampler2D own_disparity;    // the wrap of both samplers must be clamped
layout(binding = 1) uniform sampler2D other_disparity;

layout(binding = 0, r8ui) writeonly uniform uimage2D visibility;

// Work lists: mixed tiles, tiles of one value (HIDDEN is set if that is OCCLUDED), pixels. An entry is a column and a
// row: with a single index, shaders would have to divide, which is slow.
layout(std430, binding = 5) buffer Work {
    uint tiles;
    uint fills;
    uint pixels;
    uint unused;
    uint work[];
};

uniform uvec4 band;  // the part of the image that is judged now: left column, first row, width and height, in tiles

const uint UNDECIDED = 1u;

const uint HIDDEN = 0x8000u;

uint listed(uvec2 at) {
    return at.x | at.y << 16;
}

uvec2 unlisted(uint number) {
    return uvec2(number & 0x7FFFu, number >> 16);
}

// Maximum difference between the point's disparity and the other view's, interpolated between two pixels of one smooth
// surface.
const float BEND_PX = 0.02;
const float BEND_RELATIVE = 0.01;
// Maximum change of disparity from pixel to pixel that is accepted as one surface without tracing its triangles.
const float STEEPEST = 2.0;
// A surface hides a point only if it is nearer by more than this: the rounding of float32.
const float ROUNDING_PX = 1e-3;
const float ROUNDING_RELATIVE = 2e-6;

// The column at which the other eye would see a point.
float target_of(float column, float disparity_px) {
    precise float target = column + other_from_own * disparity_px;
    return target;
}

// The smallest valid disparity: that of infinity, or the lower limit of valid disparities.
float far_px() {
    return max(least_px, -doffs_px);
}

float or_far(float disparity_px) {
    return disparity_px > LARGEST ? far_px() : disparity_px;
}

// Whether the surface of the point continues from a pixel to the next: along a row, a plane's disparity is linear.
bool goes_on(float disparity_px, float between, vec2 beside) {
    precise float off = abs(mix(beside.x, beside.y, between) - disparity_px), step = abs(beside.y - beside.x);
    precise float most = BEND_PX + BEND_RELATIVE * step;
    return off < most && step < STEEPEST;
}

// Whether a surface with this 1 / Z is nearer than a point with this disparity.
bool is_before(float inverse_depth, float disparity_px) {
    float rounding_px = ROUNDING_PX + ROUNDING_RELATIVE * focal_baseline * abs(inverse_depth);
    return inverse_depth > 0.0 && focal_baseline * inverse_depth - doffs_px > disparity_px + rounding_px;
}

// A surface in the row above or below may hide the point only if its disparity exceeds the point's by this.
const float EDGE_PX = 0.25;
// A point is hidden if the disparities of all pixels around it exceed its own by this.
const float CLEARLY_PX = 0.5;
// If the disparities of two pixels differ by this, there may be a gap between their surfaces.
const float GAP_PX = 0.25;

bool is_outside(float disparity_px, float target, float last) {
    return disparity_px > LARGEST || target < -0.5 || target >= last + 0.5;
}

// Judges by six disparities of the other view: of the two pixels beside the point, and of the pixels above and below
// them. The result does not depend on how pixels are grouped.
uint judge(float disparity_px, float between, vec2 above, vec2 beside, vec2 below) {
    vec2 farthest = min(min(above, below), beside);
    precise float clearly = disparity_px + CLEARLY_PX;
    if (min(farthest.x, farthest.y) > clearly && abs(beside.y - beside.x) < GAP_PX) {
        return OCCLUDED;
    }
    return goes_on(disparity_px, between, beside) ? VISIBLE : UNDECIDED;
}

// The disparities of the four pixels that meet at a corner: left and right in the row above (w, z) and below (x, y).
vec4 around(sampler2D disparity, vec2 corner) {
    return textureGather(disparity, corner / vec2(textureSize(disparity, 0)));
}

vec4 around_far(vec2 corner) {
    vec4 values = around(other_disparity, corner);
    return vec4(or_far(values.x), or_far(values.y), or_far(values.z), or_far(values.w));
}

#if STEP == TILES
// Six disparities of a row of the other view.
struct Row { vec3 left, right; };

// The disparities in columns k and k + 1 of a row.
vec2 pair(Row row, float k) {
    vec2 far_right = k < 3.5 ? vec2(row.right.x, row.right.y) : row.right.yz;
    vec2 right = k < 2.5 ? vec2(row.left.z, row.right.x) : far_right;
    vec2 left = k < 0.5 ? row.left.xy : row.left.yz;
    return k < 1.5 ? left : right;
}

uint judge_in(float column, float disparity_px, float first, float last, Row above, Row beside, Row below) {
    float target = target_of(column, disparity_px);
    float left = floor(target);
    float k = left - first;
    uint found = judge(disparity_px, target - left, pair(above, k), pair(beside, k), pair(below, k));
    return is_outside(disparity_px, target, last) ? OUTSIDE : k < -0.5 || k > 4.5 ? UNDECIDED : found;
}

void main() {
    if (any(greaterThanEqual(gl_GlobalInvocationID.xy, band.zw))) {
        return;
    }
    uvec2 tile = band.xy + gl_GlobalInvocationID.xy;
    ivec2 last = textureSize(own_disparity, 0) - 1;
    vec2 at = vec2(4u * tile);
    vec4 own[4];
    for (int half_ = 0; half_ < 2; ++half_) {
        vec4 left = around(own_disparity, at + vec2(1.0, 1.0 + 2.0 * float(half_)));
        vec4 right = around(own_disparity, at + vec2(3.0, 1.0 + 2.0 * float(half_)));
        own[2 * half_] = vec4(left.wz, right.wz);
        own[2 * half_ + 1] = vec4(left.xy, right.xy);
    }
    vec4 column = at.x + vec4(0.0, 1.0, 2.0, 3.0);
    float first = 1e9;
    for (int row = 0; row < 4; ++row) {
        vec4 target = column + other_from_own * own[row];
        first = min(first, min(min(target.x, target.y), min(target.z, target.w)));
    }
    first = clamp(floor(first), 0.0, float(last.x));
    Row rows[6];
    for (int pair_ = 0; pair_ < 3; ++pair_) {
        vec2 corner = vec2(first + 1.0, at.y + 2.0 * float(pair_));
        vec4 a = around_far(corner), b = around_far(corner + vec2(2.0, 0.0)), c = around_far(corner + vec2(4.0, 0.0));
        rows[2 * pair_] = Row(vec3(a.wz, b.w), vec3(b.z, c.wz));
        rows[2 * pair_ + 1] = Row(vec3(a.xy, b.x), vec3(b.y, c.xy));
    }
    uint any_of = 0u, all_of = 0xFFu;
    for (int row = 0; row < 4; ++row) {
        for (int k = 0; k < 4; ++k) {
            uint found = judge_in(column[k], own[row][k], first, float(last.x), rows[row], rows[row + 1], rows[row + 2]);
            any_of |= found;
            all_of &= found;
        }
    }
    // Values are combined bit by bit: only VISIBLE contains the bit of UNDECIDED.
    if (any_of != all_of || any_of == UNDECIDED) {
        work[atomicAdd(tiles, 1u)] = listed(tile);
    } else if (any_of != VISIBLE) {
        work[band.z * band.w + atomicAdd(fills, 1u)] = listed(tile) | (any_of == OCCLUDED ? HIDDEN : 0u);
    }
}
#else
uint invocations() {
    return gl_NumWorkGroups.x * gl_WorkGroupSize.x;
}

// The first pixel of one of a listed tile's four rows.
ivec2 row_of(uint tile, uint number) {
    return ivec2(4u * unlisted(tile) + uvec2(0u, number % 4u));
}
#endif

#if STEP == FILL
void main() {
    for (uint item = gl_GlobalInvocationID.x; item < 4u * fills; item += invocations()) {
        uint fill = work[band.z * band.w + item / 4u];
        ivec2 row = row_of(fill, item);
        for (int k = 0; k < 4; ++k) {
            imageStore(visibility, row + ivec2(k, 0), uvec4((fill & HIDDEN) != 0u ? OCCLUDED : OUTSIDE));
        }
    }
}
#endif

#if STEP == PIXELS
void main() {
    ivec2 last = textureSize(own_disparity, 0) - 1;
    for (uint item = gl_GlobalInvocationID.x; item < 4u * tiles; item += invocations()) {
        ivec2 row = row_of(work[item / 4u], item);
        for (int k = 0; k < 4; ++k) {
            ivec2 pixel = row + ivec2(k, 0);
            float disparity_px = texelFetch(own_disparity, min(pixel, last), 0).r;
            float target = target_of(float(pixel.x), disparity_px);
            float left = floor(target);
            vec4 lower = around_far(vec2(left + 1.0, float(pixel.y) + 1.0)), upper = around_far(vec2(left + 1.0, pixel.y));
            uint found = judge(disparity_px, target - left, upper.wz, lower.wz, lower.xy);
            found = is_outside(disparity_px, target, float(last.x)) ? OUTSIDE : found;
            bool inside = all(lessThanEqual(pixel, last));
            if (inside && found == UNDECIDED) {
                work[2u * band.z * band.w + atomicAdd(pixels, 1u)] = listed(uvec2(pixel));
            }
            if (inside && (found == OCCLUDED || found == OUTSIDE)) {
                imageStore(visibility, pixel, uvec4(found));
            }
        }
    }
}
#endif

#if STEP == TRACE
#include "common_silhouette.glsl"

layout(binding = 2) uniform usampler2D own_surface;
layout(binding = 3) uniform usampler2D other_surface;

// The pixels around a point: beside it, then above, then below.
ivec2 start_of(int k, int left, int row, ivec2 last) {
    return clamp(ivec2(left + (k & 1), row + (k < 2 ? 0 : k < 4 ? -1 : 1)), ivec2(0), last);
}

void main() {
    ivec2 last = textureSize(own_disparity, 0) - 1;
    for (uint item = gl_GlobalInvocationID.x; item < pixels; item += invocations()) {
        ivec2 pixel = ivec2(unlisted(work[2u * band.z * band.w + item]));
        float disparity_px = texelFetch(own_disparity, pixel, 0).r;
        uvec2 own = texelFetch(own_surface, pixel, 0).rg;
        vec2 target = vec2(target_of(float(pixel.x), disparity_px), pixel.y);
        float left = floor(target.x);
        vec4 lower = around_far(vec2(left + 1.0, pixel.y + 1)), upper = around_far(vec2(left + 1.0, pixel.y));
        vec2 beside = lower.wz;
        float around[6] = {beside.x, beside.y, upper.w, upper.z, lower.x, lower.y};
        // A surface cannot hide the point if it is farther by more than a surface rises within a pixel. Nor can a
        // surface in the rows above and below that is not nearer.
        float farthest = goes_on(disparity_px, target.x - left, beside) ? LARGEST : max(disparity_px - STEEPEST, far_px());
        // The surfaces to trace: a bit for each pixel around the point. A surface does not hide itself, and is traced once.
        uint open = 0u;
        uvec2 traced = own;
        for (int k = 0; k < 6; ++k) {
            uvec2 surface = texelFetch(other_surface, start_of(k, int(left), pixel.y, last), 0).rg;
            if (surface != own && surface != traced && around[k] > (k < 2 ? farthest : disparity_px + EDGE_PX)) {
                open |= 1u << k;
                traced = surface;
            }
        }
        bool hidden = false;
        Trace trace;
        trace.ended = true;
        while (!hidden && (open != 0u || !trace.ended)) {
            if (trace.ended) {
                int k = findLSB(open);
                open &= open - 1u;
                ivec2 start = start_of(k, int(left), pixel.y, last);
                trace = trace_from(texelFetch(other_surface, start, 0).rg, vec2(start), target);
            }
            cross_triangle(trace);
            hidden = trace.ended && is_before(trace.inverse_depth, disparity_px);
        }
        if (hidden) {
            imageStore(visibility, pixel, uvec4(OCCLUDED));
        }
    }
}
#endif
