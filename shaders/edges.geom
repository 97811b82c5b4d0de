#version 450 core
// Makes a strip along an edge where a surface ends, just wide enough to cover the centres of all pixels that the edge
// crosses. If LIT, the strip carries the surface's normal in the projector's frame.

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
// The smallest depth, near / Z, of blocks of tiles: texel (x, y) of layer a * column_levels + b is for the block of 2^a
// rows and 2^b columns of tiles that begins at tile column x and row y.
layout(binding = 5) uniform sampler2DArray depth_table;
uniform int column_levels;
uniform int tile_px;
uniform vec4 part;  // the part of the image that has these tiles: left, top, width and height, px

out vec4 seen_patch;
flat out vec4 line;
#ifdef LIT
flat out vec3 normal;
#endif

// A strip has (1 + ROUNDING + rise) times the edge's 1 / Z, to pass the depth test against its own surface. The rise is
// the relative increase of the surface's 1 / Z from the edge to the strip's border. It is limited to STEEPEST or, if
// larger, to the increase within the whole triangle.
const float ROUNDING = 5e-4;
const float STEEPEST = 0.03;
// Shorter edges get no strip: their direction is inexact.
const float SHORTEST_PX = 1e-3;

// Relative tolerance of depths in the table.
const float MARGIN = 1e-3;

// Whether everything that the part of the image shows within a pixel of a box is nearer than near / Z = depth.
bool hidden(vec2 low_px, vec2 high_px, float depth) {
    ivec2 begin = ivec2(clamp(floor(low_px - 1.0) - part.xy, vec2(0.0), part.zw - 1.0)) / tile_px;
    ivec2 last = ivec2(clamp(ceil(high_px + 1.0) - part.xy, vec2(0.0), part.zw - 1.0)) / tile_px;
    // In each direction, two blocks of 2^level tiles cover all tiles: one from the first tile, one up to the last tile.
    ivec2 level = findMSB(last - begin + 1);
    ivec2 second = last + 1 - (ivec2(1) << level);
    int layer = level.y * column_levels + level.x;
    vec2 upper = vec2(texelFetch(depth_table, ivec3(begin, layer), 0).r,
                      texelFetch(depth_table, ivec3(second.x, begin.y, layer), 0).r);
    vec2 lower = vec2(texelFetch(depth_table, ivec3(begin.x, second.y, layer), 0).r,
                      texelFetch(depth_table, ivec3(second, layer), 0).r);
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
        view[k] = vec3(view_coordinate(instance.view_from_model_x, position),
                       view_coordinate(instance.view_from_model_y, position),
                       view_coordinate(instance.view_from_model_z, position));
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
    vec2 along = to_px - from_px;
    float length_px = length(along);
    // The triangle's point P = w0 V0 + w1 V1 + w2 V2 has the weights wk = dot(normals[k], P) / det. The normals are
    // V1 x V2, V2 x V0 and V0 x V1. The sign of det tells whether the corners run clockwise in the image.
    vec3 edge = view[1] - view[0];
    mat3 normals = mat3(cross(view[1], view[2] - view[1]), cross(view[2], view[0] - view[2]), cross(view[0], edge));
    float det = dot(view[2], normals[2]);
    if (length_px < SHORTEST_PX || det == 0.0) {
        return;
    }
    vec2 away = sign(det) * vec2(along.y, -along.x) / length_px;  // unit normal, away from the surface
    float reach = 0.5 * (abs(away.x) + abs(away.y));  // half the width of the strip, px
    // The derivatives of the weights by x and y of the image, at constant Z, for both ends of the edge: column k is for
    // corner k. The sum of the columns is the relative derivative of 1 / Z.
    mat3 per_px[2];
    float depth_factor[2];
    float nearest_m = max(min(view[0].z, min(view[1].z, view[2].z)), near_m);
    for (int end = 0; end < 2; ++end) {
        float depth_m = end == 0 ? from.z : to.z;
        vec3 scale = vec3(depth_m / (focal_px * det), 0.0);
        per_px[end] = mat3(normals[0] * scale, normals[1] * scale, normals[2] * scale);
        float rise = -reach * dot(per_px[end] * vec3(1.0), vec3(away, 0.0));
        depth_factor[end] = 1.0 + ROUNDING + clamp(rise, 0.0, max(STEEPEST, depth_m / nearest_m - 1.0));
    }
    float most_depth = near_m * max(depth_factor[0] / from.z, depth_factor[1] / to.z) * (1.0 + MARGIN);
    if (hidden(min(from_px, to_px), max(from_px, to_px), most_depth)) {
        return;
    }

#ifdef LIT
    // Two edges of the triangle in the projector's frame. The matrix takes Z (x, y, 1), with x and y in the window.
    vec3 edges[2];
    for (int k = 0; k < 2; ++k) {
        vec3 to_corner = view[k + 1] - view[0];
        vec2 window_px = focal_px * to_corner.xy + (centre_px + 0.5) * to_corner.z;
        edges[k] = mat3(projector_from_window) * vec3(window_px, to_corner.z);
    }
    vec3 projector_normal = cross(edges[0], edges[1]);
#endif
    for (int end = 0; end < 2; ++end) {
        vec3 corner = end == 0 ? from : to;
        vec2 uv_here = end == 0 ? mix(uv[0], uv[1], cut_from) : mix(uv[1], uv[0], cut_to);
        // Texels per pixel in x and y: the sum over corners of their weight's derivative times their texels from here.
        vec3 per_x = vec3(per_px[end][0].x, per_px[end][1].x, per_px[end][2].x);
        vec3 per_y = vec3(per_px[end][0].y, per_px[end][1].y, per_px[end][2].y);
        mat3x2 corner_texels = mat3x2(uv[0] - uv_here, uv[1] - uv_here, uv[2] - uv_here) * instance.side_texels;
        float x_texels = length(corner_texels * per_x), y_texels = length(corner_texels * per_y);
        // The part of a surface that reaches into a pixel from the side is at most half a pixel wide.
        float texels = 0.5 * max(max(x_texels, y_texels) / instance.most_samples, min(x_texels, y_texels));
        for (int side = 0; side < 2; ++side) {
            bool inside = side == 1;
            vec2 beside_px = (inside ? -reach : reach) * away;
            gl_Position = clip_from_view * vec4(corner.xy + beside_px * corner.z / focal_px, corner.z, 1.0);
            gl_Position.z = min((inside ? depth_factor[end] : 1.0 + ROUNDING) * near_m, gl_Position.w);
            seen_patch = vec4(uv_here, instance.layer, log2(max(texels, 1.0)));
            line = vec4(away, -dot(from_px + 0.5, away), instance.atlas);
#ifdef LIT
            normal = projector_normal;
#endif
            EmitVertex();
        }
    }
    EndPrimitive();
}
