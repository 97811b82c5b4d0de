#version 450 core
// Whether the other eye sees the point that a pixel of this eye shows, in a rectified pair.
//
// TILES decides 4 x 4 pixels at a time by the two disparity maps, and lists the tiles that are not wholly visible.
// PIXELS decides the pixels of these tiles, and lists the undecided ones. TRACE walks from the neighbouring pixels
// across their triangles to the point of an undecided pixel. A pixel that no step writes is VISIBLE. So is a point that
// is hidden only by surfaces that no pixel of the other view shows. Work lists keep the costly steps dense: llvmpipe
// runs eight invocations at a time through both sides of every branch.

#include "common_constants.glsl"

#define TILES 0
#define PIXELS 1
#define TRACE 2

#if STEP == TILES
layout(local_size_x = 16, local_size_y = 4) in;
#else
layout(local_size_x = 64) in;
#endif

layout(binding = 0) uniform sampler2D own_disparity;    // both samplers must clamp at the border
layout(binding = 1) uniform sampler2D other_disparity;

layout(binding = 0, r8ui) writeonly uniform uimage2D visibility;

// Two work lists: tiles, with room for all tiles of the band, then pixels. `tiles` and `pixels` are their numbers of
// entries. An entry is a column and a row, 16 bits each: a single index would need slow divisions.
layout(std430, binding = 5) buffer Work {
    uint tiles;
    uint pixels;
    uint unused[2];
    uint work[];
};

uniform uvec4 band;  // the part of the image to process: left column, first row, width and height, in tiles

const uint UNDECIDED = 1u;

uint pack(uvec2 at) {
    return at.x | at.y << 16;
}

uvec2 unpack(uint entry) {
    return uvec2(entry & 0xFFFFu, entry >> 16);
}

// Disparities of the other view at the two pixels beside a point show the point's surface if they differ by less than
// STEEPEST px, and if their interpolation differs from the point's disparity by less than BEND_PX + BEND_RELATIVE times
// their difference.
const float STEEPEST = 2.0;
const float BEND_PX = 0.02;
const float BEND_RELATIVE = 0.01;
// A surface hides a point only if its disparity exceeds the point's by more than
// ROUNDING_PX + ROUNDING_RELATIVE f B / Z: the rounding of float32.
const float ROUNDING_PX = 1e-3;
const float ROUNDING_RELATIVE = 2e-6;
// A surface in the row above or below may hide the point only if its disparity exceeds the point's by this.
const float EDGE_PX = 0.25;
// A point is hidden if the disparities of all six pixels around it exceed its disparity by CLEARLY_PX, and those beside
// it differ by less than GAP_PX. Otherwise there may be a gap between their surfaces.
const float CLEARLY_PX = 0.5;
const float GAP_PX = 0.25;

// The column at which the other eye would see a point.
float target_of(float column, float disparity_px) {
    precise float target = column + disparity_sign * disparity_px;
    return target;
}

// The smallest valid disparity: that of infinity, or the floor of valid disparities.
float farthest_px() {
    return max(disparity_floor_px, -doffs_px);
}

float or_farthest(float disparity_px) {
    return disparity_px > LARGEST ? farthest_px() : disparity_px;
}

// Whether the two pixels beside a point show its surface: along a row, a plane's disparity is linear.
bool is_same_surface(float disparity_px, float between, vec2 beside) {
    precise float error_px = abs(mix(beside.x, beside.y, between) - disparity_px), step_px = abs(beside.y - beside.x);
    precise float tolerance_px = BEND_PX + BEND_RELATIVE * step_px;
    return error_px < tolerance_px && step_px < STEEPEST;
}

// Whether a surface with this 1 / Z is nearer than a point with this disparity.
bool is_before(float inverse_depth, float disparity_px) {
    float rounding_px = ROUNDING_PX + ROUNDING_RELATIVE * focal_baseline * abs(inverse_depth);
    return inverse_depth > 0.0 && focal_baseline * inverse_depth - doffs_px > disparity_px + rounding_px;
}

bool is_outside(float disparity_px, float target, float last) {
    return disparity_px > LARGEST || target < -0.5 || target >= last + 0.5;
}

// The visibility of a point by six disparities of the other view, or UNDECIDED: of the two pixels beside the point, and
// of the pixels above and below them. TILES and PIXELS have the same result.
uint decide(float disparity_px, float between, vec2 above, vec2 beside, vec2 below) {
    vec2 farthest = min(min(above, below), beside);
    precise float limit_px = disparity_px + CLEARLY_PX;
    if (min(farthest.x, farthest.y) > limit_px && abs(beside.y - beside.x) < GAP_PX) {
        return OCCLUDED;
    }
    return is_same_surface(disparity_px, between, beside) ? VISIBLE : UNDECIDED;
}

// The disparities of the four pixels that meet at a corner: left and right in the row above (w, z) and below (x, y).
vec4 own_around(vec2 corner) {
    return textureGather(own_disparity, corner / vec2(textureSize(own_disparity, 0)));
}

vec4 other_around(vec2 corner) {
    vec4 values = textureGather(other_disparity, corner / vec2(textureSize(other_disparity, 0)));
    return vec4(or_farthest(values.x), or_farthest(values.y), or_farthest(values.z), or_farthest(values.w));
}

#if STEP == TILES
// Six successive disparities in a row of the other view.
struct Row { vec3 left, right; };

// The disparities in columns k and k + 1 of a row, with k from 0 to 4.
vec2 two_of(Row row, float k) {
    vec2 far_right = k < 3.5 ? vec2(row.right.x, row.right.y) : row.right.yz;
    vec2 right = k < 2.5 ? vec2(row.left.z, row.right.x) : far_right;
    vec2 left = k < 0.5 ? row.left.xy : row.left.yz;
    return k < 1.5 ? left : right;
}

uint decide_in(float column, float disparity_px, float first, float last, Row above, Row beside, Row below) {
    float target = target_of(column, disparity_px);
    float left = floor(target);
    float k = left - first;
    uint found = decide(disparity_px, target - left, two_of(above, k), two_of(beside, k), two_of(below, k));
    return is_outside(disparity_px, target, last) ? OUTSIDE : k < -0.5 || k > 4.5 ? UNDECIDED : found;
}

void main() {
    if (any(greaterThanEqual(gl_GlobalInvocationID.xy, band.zw))) {
        return;
    }
    uvec2 tile = band.xy + gl_GlobalInvocationID.xy;
    ivec2 last = textureSize(own_disparity, 0) - 1;
    vec2 at = vec2(4u * tile);
    vec4 own[4];  // the tile's disparities, row by row
    for (int k = 0; k < 2; ++k) {
        vec4 left = own_around(at + vec2(1.0, 1.0 + 2.0 * float(k)));
        vec4 right = own_around(at + vec2(3.0, 1.0 + 2.0 * float(k)));
        own[2 * k] = vec4(left.wz, right.wz);
        own[2 * k + 1] = vec4(left.xy, right.xy);
    }
    vec4 column = at.x + vec4(0.0, 1.0, 2.0, 3.0);
    float first = 1e9;  // the leftmost column of the other view in which a point of the tile is looked up
    for (int row = 0; row < 4; ++row) {
        vec4 target = column + disparity_sign * own[row];
        first = min(first, min(min(target.x, target.y), min(target.z, target.w)));
    }
    first = clamp(floor(first), 0.0, float(last.x));
    Row rows[6];  // of the other view, from the row above the tile to the row below it
    for (int k = 0; k < 3; ++k) {
        vec2 corner = vec2(first + 1.0, at.y + 2.0 * float(k));
        vec4 a = other_around(corner), b = other_around(corner + vec2(2.0, 0.0));
        vec4 c = other_around(corner + vec2(4.0, 0.0));
        rows[2 * k] = Row(vec3(a.wz, b.w), vec3(b.z, c.wz));
        rows[2 * k + 1] = Row(vec3(a.xy, b.x), vec3(b.y, c.xy));
    }
    bool all_visible = true;
    for (int row = 0; row < 4; ++row) {
        for (int k = 0; k < 4; ++k) {
            uint found =
                decide_in(column[k], own[row][k], first, float(last.x), rows[row], rows[row + 1], rows[row + 2]);
            all_visible = all_visible && found == VISIBLE;
        }
    }
    if (!all_visible) {
        work[atomicAdd(tiles, 1u)] = pack(tile);
    }
}
#else
uint invocations() {
    return gl_NumWorkGroups.x * gl_WorkGroupSize.x;
}
#endif

#if STEP == PIXELS
void main() {
    ivec2 last = textureSize(own_disparity, 0) - 1;
    for (uint item = gl_GlobalInvocationID.x; item < 4u * tiles; item += invocations()) {
        ivec2 row = ivec2(4u * unpack(work[item / 4u]) + uvec2(0u, item % 4u));
        for (int k = 0; k < 4; ++k) {
            ivec2 pixel = row + ivec2(k, 0);
            float disparity_px = texelFetch(own_disparity, min(pixel, last), 0).r;
            float target = target_of(float(pixel.x), disparity_px);
            float left = floor(target);
            vec4 lower = other_around(vec2(left + 1.0, float(pixel.y) + 1.0));
            vec4 upper = other_around(vec2(left + 1.0, pixel.y));
            uint found = decide(disparity_px, target - left, upper.wz, lower.wz, lower.xy);
            found = is_outside(disparity_px, target, float(last.x)) ? OUTSIDE : found;
            bool inside = all(lessThanEqual(pixel, last));
            if (inside && found == UNDECIDED) {
                work[band.z * band.w + atomicAdd(pixels, 1u)] = pack(uvec2(pixel));
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

// The six pixels around a point, relative to the one on its left: beside it, above, below.
const ivec2 AROUND[6] =
    ivec2[6](ivec2(0, 0), ivec2(1, 0), ivec2(0, -1), ivec2(1, -1), ivec2(0, 1), ivec2(1, 1));

void main() {
    ivec2 last = textureSize(own_disparity, 0) - 1;
    for (uint item = gl_GlobalInvocationID.x; item < pixels; item += invocations()) {
        ivec2 pixel = ivec2(unpack(work[band.z * band.w + item]));
        float disparity_px = texelFetch(own_disparity, pixel, 0).r;
        uvec2 own = texelFetch(own_surface, pixel, 0).rg;
        vec2 target = vec2(target_of(float(pixel.x), disparity_px), pixel.y);
        float left = floor(target.x);
        vec4 lower = other_around(vec2(left + 1.0, pixel.y + 1)), upper = other_around(vec2(left + 1.0, pixel.y));
        vec2 beside = lower.wz;
        float around[6] = {beside.x, beside.y, upper.w, upper.z, lower.x, lower.y};
        // A surface beside the point hides it only if its disparity exceeds this limit: from pixel to pixel, surfaces
        // rise by STEEPEST at most. If both pixels beside the point show the point's surface, nothing there hides it.
        float limit_px = is_same_surface(disparity_px, target.x - left, beside)
            ? LARGEST : max(disparity_px - STEEPEST, farthest_px());
        // A bit for each pixel whose surface is to be traced: not the point's surface, and none twice in succession.
        uint to_trace = 0u;
        uvec2 previous = own;
        for (int k = 0; k < 6; ++k) {
            ivec2 start = clamp(ivec2(int(left), pixel.y) + AROUND[k], ivec2(0), last);
            uvec2 surface = texelFetch(other_surface, start, 0).rg;
            if (surface != own && surface != previous && around[k] > (k < 2 ? limit_px : disparity_px + EDGE_PX)) {
                to_trace |= 1u << k;
                previous = surface;
            }
        }
        bool hidden = false;
        Trace trace;
        trace.ended = true;
        while (!hidden && (to_trace != 0u || !trace.ended)) {
            if (trace.ended) {
                int k = findLSB(to_trace);
                to_trace &= to_trace - 1u;  // clear bit k
                ivec2 start = clamp(ivec2(int(left), pixel.y) + AROUND[k], ivec2(0), last);
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
