#version 450 core
// Where the same eye sees the point of a pixel at a target moment, and whether the point is visible then. With
// OTHER_EYE, the other eye's view replaces the target moment, and the disparity is computed, too.
//
// DEPTHS decides most pixels by the depth map of the target moment, and lists the undecided pixels. TRACE walks from
// the neighbouring pixels across their triangles to the point of an undecided pixel.

#include "common_constants.glsl"
#include "common_disparity.glsl"

#define DEPTHS 0
#define TRACE 1

#if STEP == DEPTHS
layout(local_size_x = 16, local_size_y = 4) in;
#else
layout(local_size_x = 64) in;
#endif

layout(binding = 0) uniform sampler2D own_depth;       // m; inf where nothing is drawn, or the sky
layout(binding = 1) uniform usampler2D own_surface;
layout(binding = 2) uniform sampler2D then_depth;      // at the target moment; the sampler must clamp at the border
layout(binding = 3) uniform usampler2D then_surface;

layout(binding = 0, rg32f) writeonly uniform image2D flow;
layout(binding = 1, r32f) writeonly uniform image2D disparity;  // with OTHER_EYE the disparity, else its change
layout(binding = 2, r8ui) writeonly uniform uimage2D flow_visibility;

struct Move {
    vec4 change_and_shift_x;   // rows of C and s: the point c + q moves to c + s + (I + C) q
    vec4 change_and_shift_y;
    vec4 change_and_shift_z;
    vec4 centre;               // c, relative to this eye
    uvec4 then;                // the instance's number at the target moment, or GONE
};

#ifdef OTHER_EYE
layout(binding = 6) uniform sampler2D own_disparity;

uniform vec4 change_and_shift[3];  // as in Move, for all instances, with c = 0
uniform vec4 own_lens;             // principal point and focal lengths of this eye; the constants have the other eye's
uniform vec4 lens_change;          // the other eye's lens minus this eye's, computed in float64
uniform bool rectified;            // then the disparities are those of own_disparity

Move move_of(uint instance) {
    return Move(change_and_shift[0], change_and_shift[1], change_and_shift[2], vec4(0.0), uvec4(instance));
}
#else
layout(std430, binding = 4) readonly buffer Moves { Move moves[]; };

Move move_of(uint instance) {
    return moves[instance];
}
#endif

// The work list, after the number of its entries. An entry is a pixel: column and row, 16 bits each.
layout(std430, binding = 5) buffer Work {
    uint pixels;
    uint unused[3];
    uint work[];
};

uniform uvec4 band;  // the part of the image to process: left column, first row, width and height, px

const uint UNDECIDED = 1u;
const uint GONE = 0xFFFFFFFFu;
const uint NOTHING = 0xFFFFFFFFu;
// A surface hides a point if its 1 / Z is larger by more than this, relative: the rounding of float32.
const float ROUNDING = 2e-5;
// Maximum relative difference of a point's 1 / Z from the bilinear interpolation of four pixels that show its surface.
const float BEND = 2e-4;
// Maximum relative difference of 1 / Z between neighbouring pixels of a surface.
const float STEEPEST = 0.01;

// The motion of a point to the target moment ("then").
struct Motion {
    float inverse_depth;  // 1 / Z now
    float depth_change;   // (Z then - Z now) / Z now
    float depth_ratio;    // Z then / Z now
    vec2 flow_px;
};

// In units of Z now, the point is ray = ((x - cx) / fx, (y - cy) / fy, 1) now and ray + displacement then.
Motion motion_of(ivec2 pixel, float depth_m, Move move) {
    float inverse_depth = depth_m > LARGEST ? 0.0 : 1.0 / depth_m;
#ifdef OTHER_EYE
    vec3 ray = vec3((vec2(pixel) - own_lens.xy) / own_lens.zw, 1.0);
#else
    vec3 ray = vec3((vec2(pixel) - centre_px) / focal_px, 1.0);
#endif
    // (C q + s) / Z with q = Z ray - c. It is no difference of two positions, so a small motion has small errors.
    vec4 from_centre = vec4(ray - move.centre.xyz * inverse_depth, inverse_depth);
    vec3 displacement = vec3(dot(move.change_and_shift_x, from_centre), dot(move.change_and_shift_y, from_centre),
                             dot(move.change_and_shift_z, from_centre));
    float depth_ratio = 1.0 + displacement.z;
    // f ((ray + displacement).xy / depth_ratio - ray.xy)
    vec2 flow_px = focal_px * (displacement.xy - ray.xy * displacement.z) / depth_ratio;
#ifdef OTHER_EYE
    flow_px += lens_change.zw * ray.xy + lens_change.xy;
#endif
    return Motion(inverse_depth, displacement.z, depth_ratio, flow_px);
}

// 1 / Z then of the four pixels around a position: x and y are the lower left and right pixels, w and z the upper ones.
vec4 inverse_depths_around(vec2 target) {
    vec2 corner = (floor(target) + 1.0) / vec2(textureSize(then_depth, 0));
    return 1.0 / textureGather(then_depth, corner);
}

#if STEP == DEPTHS
// The visibility of a point by the four pixels around it, or UNDECIDED.
uint decide(vec2 target, float inverse_depth_then, uint instance_then) {
    vec4 corners = inverse_depths_around(target);
    float nearest = max(max(corners.x, corners.y), max(corners.z, corners.w));
    float farthest = min(min(corners.x, corners.y), min(corners.z, corners.w));
    uvec4 instances = textureGather(then_surface, (floor(target) + 1.0) / vec2(textureSize(then_surface, 0)), 0);
    vec2 between = fract(target);
    float expected = mix(mix(corners.w, corners.z, between.x), mix(corners.x, corners.y, between.x), between.y);
    bool is_sky = nearest == 0.0;
    bool same_surface = all(equal(instances, uvec4(instance_then))) && (is_sky
        || nearest - farthest < STEEPEST * nearest && abs(expected - inverse_depth_then) < BEND * inverse_depth_then);
    bool hidden = farthest > (1.0 + STEEPEST) * inverse_depth_then;
    return hidden ? OCCLUDED : same_surface ? VISIBLE : UNDECIDED;
}

void main() {
    if (any(greaterThanEqual(gl_GlobalInvocationID.xy, band.zw))) {
        return;
    }
    ivec2 pixel = ivec2(band.xy + gl_GlobalInvocationID.xy);
    vec2 flow_px = vec2(INVALID);
    float disparity_px = INVALID;
    uint seen = OUTSIDE;
    float depth_m = texelFetch(own_depth, pixel, 0).r;
    uint instance = texelFetch(own_surface, pixel, 0).r;
    if (instance != NOTHING) {
        Move move = move_of(instance);
        Motion motion = motion_of(pixel, depth_m, move);
#ifdef OTHER_EYE
        disparity_px = rectified ? texelFetch(own_disparity, pixel, 0).r
                                 : or_invalid(disparity_sign * motion.flow_px.x);
        if (rectified) {
            motion.flow_px = vec2(disparity_sign * disparity_px, 0.0);
        }
        bool known = disparity_px < LARGEST;
#else
        bool known = true;
#endif
        if (known && !(motion.depth_ratio * depth_m < near_m)) {
            flow_px = motion.flow_px;
            float inverse_depth_then = motion.inverse_depth / motion.depth_ratio;
#ifndef OTHER_EYE
            if (disparity_at(motion.inverse_depth) < LARGEST && disparity_at(inverse_depth_then) < LARGEST) {
                disparity_px = -focal_baseline * motion.inverse_depth * motion.depth_change / motion.depth_ratio;
            }
#endif
            vec2 target = vec2(pixel) + flow_px, end = vec2(textureSize(own_depth, 0) - 1) + 0.5;
            if (!any(lessThan(target, vec2(-0.5))) && !any(greaterThanEqual(target, end))) {
                seen = move.then.x == GONE ? OCCLUDED : decide(target, inverse_depth_then, move.then.x);
            }
        }
    }
    if (seen == UNDECIDED) {
        work[atomicAdd(pixels, 1u)] = uint(pixel.x) | uint(pixel.y) << 16;
        seen = VISIBLE;
    }
    imageStore(flow, pixel, vec4(flow_px, 0.0, 0.0));
    imageStore(disparity, pixel, vec4(disparity_px));
    imageStore(flow_visibility, pixel, uvec4(seen));
}
#else
#include "common_silhouette.glsl"

void main() {
    ivec2 last = textureSize(own_depth, 0) - 1;
    for (uint item = gl_GlobalInvocationID.x; item < pixels; item += gl_NumWorkGroups.x * gl_WorkGroupSize.x) {
        ivec2 pixel = ivec2(work[item] & 0xFFFFu, work[item] >> 16);
        uvec2 own = texelFetch(own_surface, pixel, 0).rg;
        Move move = move_of(own.x);
        Motion motion = motion_of(pixel, texelFetch(own_depth, pixel, 0).r, move);
        float inverse_depth_then = motion.inverse_depth / motion.depth_ratio;
        vec2 target = vec2(pixel) + motion.flow_px;
        vec4 corners = inverse_depths_around(target);
        const ivec2 OFFSETS[4] = ivec2[4](ivec2(0, 1), ivec2(1, 1), ivec2(1, 0), ivec2(0, 0));
        for (int k = 0; k < 4; ++k) {
            // A surface does not hide points that are nearer by more than it rises within a pixel. Nor does the sky.
            if (corners[k] == 0.0 || corners[k] * (1.0 + 2.0 * STEEPEST) < inverse_depth_then) {
                continue;
            }
            ivec2 beside = clamp(ivec2(floor(target)) + OFFSETS[k], ivec2(0), last);
            uvec2 surface = texelFetch(then_surface, beside, 0).rg;
            if (surface != uvec2(move.then.x, own.y)
                && surface_at(surface, vec2(beside), target) > (1.0 + ROUNDING) * inverse_depth_then) {
                imageStore(flow_visibility, pixel, uvec4(OCCLUDED));
                break;
            }
        }
    }
}
#endif
