#version 450 core
// Whether the other eye sees the point that a pixel of this eye shows.
//
// Four steps, each for what the one before leaves open. TILES judges 4 x 4 pixels at a time by the two disparity maps, and
// lists the tiles whose pixels are not all visible: FILL writes those that are alike, PIXELS judges the others one by one
// and lists the pixels that the disparity maps leave open. TRACE follows the surfaces around such a point to it. What no
// step writes is VISIBLE. Lists keep the costly steps dense: llvmpipe runs eight invocations at a time through both sides
// of every branch.

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

layout(binding = 0) uniform sampler2D own_disparity;    // the wrap of both must be clamped
layout(binding = 1) uniform sampler2D other_disparity;

layout(binding = 0, r8ui) writeonly uniform uimage2D visibility;

// What is listed: tiles of mixed pixels, tiles of pixels alike (with a mark where they are hidden), pixels. All are listed as
// column and row, since processors divide slowly.
layout(std430, binding = 5) buffer Work {
    uint tiles;
    uint fills;
    uint pixels;
    uint unused;
    uint work[];
};

uniform uvec4 band;  // tiles: left column, first row, width and height of what is judged now

const uint UNDECIDED = 1u;

const uint HIDDEN = 0x8000u;

uint listed(uvec2 at) {
    return at.x | at.y << 16;
}

uvec2 unlisted(uint number) {
    return uvec2(number & 0x7FFFu, number >> 16);
}

// How far the other view's surface may be from the point's disparity between two pixels of one smooth surface.
const float BEND_PX = 0.02;
const float BEND_RELATIVE = 0.01;
// Change of disparity from pixel to pixel that passes for one surface without a look at its triangles.
const float STEEPEST = 2.0;
// What is nearer by this hides, where it is so all around.
const float CLEARLY_PX = 0.5;
// What stands out of a row by this has an edge there.
const float EDGE_PX = 0.25;
// Two pixels that differ by less leave no gap between them.
const float GAP_PX = 1.0;

// Where the other eye would see a point, in its columns.
float target_of(float column, float disparity_px) {
    precise float target = column + other_from_own * disparity_px;
    return target;
}

bool is_outside(float disparity_px, float target, float last) {
    return disparity_px > LARGEST || target < -0.5 || target >= last + 0.5;
}

// No disparity is smaller: that of what is infinitely far away, or the end of the valid ones.
float far_px() {
    return max(least_px, -doffs_px);
}

float or_far(float disparity_px) {
    return disparity_px > LARGEST ? far_px() : disparity_px;
}

// Which of two pixels, of the row above or below, are nearer than a surface that goes on from row to row, which is as
// much nearer on one side as it is farther on the other.
bvec2 stands_out(float disparity_px, vec2 side, vec2 opposite) {
    precise vec2 edge = disparity_px + EDGE_PX + clamp(vec2(disparity_px) - opposite, 0.0, STEEPEST);
    return greaterThan(side, edge);
}

// Whether one surface with the point on it goes from a pixel to the next: along the row of a plane, disparity is linear.
bool goes_on(float disparity_px, float between, vec2 beside) {
    precise float off = abs(mix(beside.x, beside.y, between) - disparity_px), step = abs(beside.y - beside.x);
    precise float most = BEND_PX + BEND_RELATIVE * step;
    return off < most && step < STEEPEST;
}

// By the disparities of the other view's two pixels beside the point, and of those above and below. All steps come to the
// same, whichever pixels they judge together.
uint judge(float disparity_px, float between, vec2 above, vec2 beside, vec2 below) {
    vec2 farthest = min(min(above, below), beside);
    // What stands out in both columns has its edge between the rows; in one of them, it may be thin and pass between them.
    bvec2 over = stands_out(disparity_px, above, below), under = stands_out(disparity_px, below, above);
    bool thin = over.x != over.y || under.x != under.y;
    precise float clearly = disparity_px + CLEARLY_PX;
    if (min(farthest.x, farthest.y) > clearly && abs(beside.y - beside.x) < GAP_PX) {
        return OCCLUDED;
    }
    return goes_on(disparity_px, between, beside) && !thin ? VISIBLE : UNDECIDED;
}

// The four pixels around a corner of pixels: beside each other in the row above (w, z) and below (x, y) the corner.
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

// Those in columns k and k + 1.
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
    // The values' bits: UNDECIDED is in none of the others but VISIBLE.
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

void main() {
    ivec2 last = textureSize(own_disparity, 0) - 1;
    for (uint item = gl_GlobalInvocationID.x; item < pixels; item += invocations()) {
        ivec2 pixel = ivec2(unlisted(work[2u * band.z * band.w + item]));
        float disparity_px = texelFetch(own_disparity, pixel, 0).r;
        uvec2 own = texelFetch(own_surface, pixel, 0).rg;
        vec2 target = vec2(target_of(float(pixel.x), disparity_px), pixel.y);
        int left = int(floor(target.x));
        vec4 lower = around_far(vec2(left + 1, pixel.y + 1)), upper = around_far(vec2(left + 1, pixel.y));
        float between = target.x - float(left);
        // What is farther by more than a surface rises within a pixel hides nothing.
        float farthest = goes_on(disparity_px, between, lower.wz) ? LARGEST : max(disparity_px - STEEPEST, far_px());
        bvec2 beside = greaterThan(lower.wz, vec2(farthest));
        // A surface does not hide itself, and is followed once.
        uvec2 on_left = texelFetch(other_surface, clamp(ivec2(left, pixel.y), ivec2(0), last), 0).rg;
        uvec2 on_right = texelFetch(other_surface, clamp(ivec2(left + 1, pixel.y), ivec2(0), last), 0).rg;
        beside.x = beside.x && on_left != own;
        beside.y = beside.y && on_right != own && !(beside.x && on_left == on_right);
        bvec2 above = stands_out(disparity_px, upper.wz, lower.xy), below = stands_out(disparity_px, lower.xy, upper.wz);
        uint open = (beside.x ? 1u : 0u) | (beside.y ? 2u : 0u);
        open |= (above.x ? 4u : 0u) | (above.y ? 8u : 0u);
        open |= (below.x ? 16u : 0u) | (below.y ? 32u : 0u);
        bool hidden = false;
        while (open != 0u && !hidden) {
            int k = findLSB(open);
            open &= open - 1u;
            ivec2 start = clamp(ivec2(left + (k & 1), pixel.y + (k < 2 ? 0 : k < 4 ? -1 : 1)), ivec2(0), last);
            hidden = hides(texelFetch(other_surface, start, 0).rg, own, vec2(start), target, disparity_px);
        }
        if (hidden) {
            imageStore(visibility, pixel, uvec4(OCCLUDED));
        }
    }
}
#endif
