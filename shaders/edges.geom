#version 450 core
// Makes a strip along an edge where a surface ends. The strip reaches half a pixel's extent to both sides of the edge.
// If LIT, it carries the surface's normal in the projector's frame.

layout(points) in;
layout(triangle_strip, max_vertices = 4) out;

#include "common_constants.glsl"
#include "common_placement.glsl"
#ifdef LIT
#include "common_projector.glsl"
#endif

struct PatchedInstance {
    vec4 view_from_model_x;  // rows, relative to the eye whose view is drawn
    vec4 view_from_model_y;
    vec4 view_from_model_z;
    vec4 patch_from_uv;      // scale.xy, offset.xy
    float layer;             // of the patch in its atlas
    float atlas;             // 0, or 1 for large patches
    float side_texels;       // of the patch
    float most_samples;      // maximum number of samples of the patch for a pixel
};

layout(std430, binding = 0) readonly buffer Vertices { float vertex[]; };  // x y z u v of each
layout(std430, binding = 5) readonly buffer Instances { PatchedInstance instances[]; };
// Instance, and three vertices of the triangle in front: the begin and the end of the edge, and the opposite vertex.
layout(std430, binding = 6) readonly buffer Strips { uvec4 strips[]; };
// Smallest depth, near / Z, in blocks of 2^a x 2^b tiles of the image: by the block's first tile, in layer a * levels +
// b.
layout(binding = 5) uniform sampler2DArray farthest;
uniform int levels;
uniform int tile_px;
uniform vec4 part;  // the part of the image that has these tiles: left, top, width and height, px

out vec4 seen_patch;
flat out vec4 line;
#ifdef LIT
flat out vec3 normal;
#endif

// A strip is nearer than its surface by a share of 1 / Z: by ROUNDING, plus the amount by which the surface comes
// nearer within a pixel. This amount is limited to STEEPEST or, if that is larger, to the amount within the whole
// triangle.
const float ROUNDING = 5e-4;
const float STEEPEST = 0.03;
// Shorter edges get no strip.
const float SHORTEST_PX = 1e-3;

// Margin for rounding of depths, as a share.
const float MARGIN = 1e-3;

// Whether everything that the part of the image shows within a pixel of a box is nearer than near / Z = depth.
bool hidden(vec2 low_px, vec2 high_px, float depth) {
    ivec2 begin = ivec2(clamp(floor(low_px - 1.0) - part.xy, vec2(0.0), part.zw - 1.0)) / tile_px;
    ivec2 last = ivec2(clamp(ceil(high_px + 1.0) - part.xy, vec2(0.0), part.zw - 1.0)) / tile_px;
    // Two spans of the same power of two cover all tiles from the first to the last.
    ivec2 level = findMSB(last - begin + 1);
    ivec2 second = last + 1 - (ivec2(1) << level);
    int layer = level.y * levels + level.x;
    vec2 upper = vec2(texelFetch(farthest, ivec3(begin, layer), 0).r,
                      texelFetch(farthest, ivec3(second.x, begin.y, layer), 0).r);
    vec2 lower = vec2(texelFetch(farthest, ivec3(begin.x, second.y, layer), 0).r,
                      texelFetch(farthest, ivec3(second, layer), 0).r);
    vec2 least = min(upper, lower);
    return depth < min(least.x, least.y);
}

void main() {
    uvec4 strip = strips[gl_PrimitiveIDIn];
    PatchedInstance instance = instances[strip.x];
    vec3 view[3];
    vec2 uv[3];
    for (int k = 0; k < 3; ++k) {
        uint at = 5u * strip[k + 1];
        vec3 position = vec3(vertex[at], vertex[at + 1u], vertex[at + 2u]);
        view[k] = vec3(placed(instance.view_from_model_x, position), placed(instance.view_from_model_y, position),
                       placed(instance.view_from_model_z, position));
        uv[k] = vec2(vertex[at + 3u], vertex[at + 4u]) * instance.patch_from_uv.xy + instance.patch_from_uv.zw;
    }

    // Cut off the part of the edge in front of the near plane.
    vec3 from = view[0], to = view[1];
    float cut_from = from.z < near_m ? (near_m - from.z) / (to.z - from.z) : 0.0;
    float cut_to = to.z < near_m ? (near_m - to.z) / (from.z - to.z) : 0.0;
    if (max(view[0].z, view[1].z) <= near_m) {
        return;
    }
    from = mix(from, view[1], cut_from);
    to = mix(to, view[0], cut_to);
    vec2 from_px = focal_px * from.xy / from.z + centre_px, to_px = focal_px * to.xy / to.z + centre_px;
    vec2 way = to_px - from_px;
    float length_px = length(way);
    // Sides of the pyramid from the eye through the triangle. They give the weights of the triangle's corners, and
    // their sign is that of the corners' order in the image.
    vec3 edge = view[1] - view[0];
    mat3 sides = mat3(cross(view[1], view[2] - view[1]), cross(view[2], view[0] - view[2]), cross(view[0], edge));
    float order = dot(view[2], sides[2]);
    if (length_px < SHORTEST_PX || order == 0.0) {
        return;
    }
    vec2 away = sign(order) * vec2(way.y, -way.x) / length_px;
    float reach = 0.5 * (abs(away.x) + abs(away.y));
    // For each end: how much the weights of the triangle's corners change from pixel to pixel. UV and 1 / Z follow
    // them.
    mat3 change[2];
    float nearer[2];
    float nearest_m = max(min(view[0].z, min(view[1].z, view[2].z)), near_m);
    for (int end = 0; end < 2; ++end) {
        float depth_m = end == 0 ? from.z : to.z;
        vec3 per_pixel = vec3(depth_m / (focal_px * order), 0.0);
        change[end] = mat3(sides[0] * per_pixel, sides[1] * per_pixel, sides[2] * per_pixel);
        float rise = -reach * dot(change[end] * vec3(1.0), vec3(away, 0.0));
        nearer[end] = 1.0 + ROUNDING + clamp(rise, 0.0, max(STEEPEST, depth_m / nearest_m - 1.0));
    }
    float most_depth = near_m * max(nearer[0] / from.z, nearer[1] / to.z) * (1.0 + MARGIN);
    if (hidden(min(from_px, to_px), max(from_px, to_px), most_depth)) {
        return;
    }

#ifdef LIT
    // Two sides of the triangle, from positions (x, y, 1) in the window times Z.
    vec3 ways[2];
    for (int k = 0; k < 2; ++k) {
        vec3 to_corner = view[k + 1] - view[0];
        vec2 window_px = focal_px * to_corner.xy + (centre_px + 0.5) * to_corner.z;
        ways[k] = mat3(projector_from_window) * vec3(window_px, to_corner.z);
    }
    vec3 facing = cross(ways[0], ways[1]);
#endif
    for (int end = 0; end < 2; ++end) {
        vec3 corner = end == 0 ? from : to;
        vec2 uv_here = end == 0 ? mix(uv[0], uv[1], cut_from) : mix(uv[1], uv[0], cut_to);
        mat3 weights = change[end];
        vec3 along_x = vec3(weights[0].x, weights[1].x, weights[2].x), along_y = vec3(weights[0].y, weights[1].y, weights[2].y);
        mat3x2 around = mat3x2(uv[0] - uv_here, uv[1] - uv_here, uv[2] - uv_here) * instance.side_texels;
        float x_texels = length(around * along_x), y_texels = length(around * along_y);
        // The part of a surface that reaches into a pixel from the side is at most half a pixel wide.
        float texels = 0.5 * max(max(x_texels, y_texels) / instance.most_samples, min(x_texels, y_texels));
        for (int side = 0; side < 2; ++side) {
            bool inside = side == 1;
            vec2 beside_px = (inside ? -reach : reach) * away;
            gl_Position = clip_from_view * vec4(corner.xy + beside_px * corner.z / focal_px, corner.z, 1.0);
            gl_Position.z = min((inside ? nearer[end] : 1.0 + ROUNDING) * near_m, gl_Position.w);
            seen_patch = vec4(uv_here, instance.layer, log2(max(texels, 1.0)));
            line = vec4(away, -dot(from_px + 0.5, away), instance.atlas);
#ifdef LIT
            normal = facing;
#endif
            EmitVertex();
        }
    }
    EndPrimitive();
}
