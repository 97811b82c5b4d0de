#version 450 core
// Makes a strip along an edge where a surface ends; it reaches half a pixel's extent to both sides of the edge. If LIT, it
// carries the surface's normal in the projector's frame.

layout(points) in;
layout(triangle_strip, max_vertices = 4) out;

#include "common_constants.glsl"
#include "common_placement.glsl"
#ifdef LIT
#include "common_projector.glsl"
#endif

struct Wearer {
    vec4 view_from_model_x;  // rows, relative to the eye that draws
    vec4 view_from_model_y;
    vec4 view_from_model_z;
    vec4 patch_from_uv;      // scale.xy, offset.xy
    vec4 worn;               // layer, atlas, its patches' side in texels, and most samples of them
};

layout(std430, binding = 0) readonly buffer Vertices { float vertex[]; };  // x y z u v of each
layout(std430, binding = 5) readonly buffer Wearers { Wearer wearers[]; };
// Instance, and three vertices of the triangle in front: from where to where the edge goes, and the one opposite.
layout(std430, binding = 6) readonly buffer Strips { uvec4 strips[]; };
// Smallest depth, near / Z, that the image has in blocks of 2^a x 2^b tiles, by first tile, in layer a * levels + b.
layout(binding = 5) uniform sampler2DArray farthest;
uniform int levels;
uniform int tile_px;
uniform vec4 part;  // of the image, in which the tiles are counted: left, top, width and height, px

out vec4 seen_patch;
flat out vec4 line;
#ifdef LIT
flat out vec3 normal;
#endif

// Shares of 1 / Z by which a strip is nearer than its surface: ROUNDING for rounding, and as much as the surface comes
// nearer within a pixel. The latter is limited to STEEPEST or, if it is more, to what the triangle itself comes nearer.
const float ROUNDING = 5e-4;
const float STEEPEST = 0.03;
// Length below which an edge is left out.
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
    Wearer wearer = wearers[strip.x];
    vec3 view[3];
    vec2 uv[3];
    for (int k = 0; k < 3; ++k) {
        uint at = 5u * strip[k + 1];
        vec3 position = vec3(vertex[at], vertex[at + 1u], vertex[at + 2u]);
        view[k] = vec3(placed(wearer.view_from_model_x, position), placed(wearer.view_from_model_y, position),
                       placed(wearer.view_from_model_z, position));
        uv[k] = vec2(vertex[at + 3u], vertex[at + 4u]) * wearer.patch_from_uv.xy + wearer.patch_from_uv.zw;
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
    // Sides of the pyramid from the eye through the triangle: they weigh its corners, and their sign is that of the
    // corners' order in the image.
    vec3 edge = view[1] - view[0];
    mat3 sides = mat3(cross(view[1], view[2] - view[1]), cross(view[2], view[0] - view[2]), cross(view[0], edge));
    float order = dot(view[2], sides[2]);
    if (length_px < SHORTEST_PX || order == 0.0) {
        return;
    }
    vec2 away = sign(order) * vec2(way.y, -way.x) / length_px;
    float reach = 0.5 * (abs(away.x) + abs(away.y));
    // For each end: how the weights of the triangle's corners change from pixel to pixel, and with them UV and 1 / Z.
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
        mat3x2 around = mat3x2(uv[0] - uv_here, uv[1] - uv_here, uv[2] - uv_here) * wearer.worn.z;
        float x_texels = length(around * along_x), y_texels = length(around * along_y);
        // A part that reaches into a pixel from its side is at most half a pixel wide.
        float texels = 0.5 * max(max(x_texels, y_texels) / wearer.worn.w, min(x_texels, y_texels));
        for (int side = 0; side < 2; ++side) {
            bool inside = side == 1;
            vec2 beside_px = (inside ? -reach : reach) * away;
            gl_Position = clip_from_view * vec4(corner.xy + beside_px * corner.z / focal_px, corner.z, 1.0);
            gl_Position.z = min((inside ? nearer[end] : 1.0 + ROUNDING) * near_m, gl_Position.w);
            seen_patch = vec4(uv_here, wearer.worn.x, log2(max(texels, 1.0)));
            line = vec4(away, -dot(from_px + 0.5, away), wearer.worn.y);
#ifdef LIT
            normal = facing;
#endif
            EmitVertex();
        }
    }
    EndPrimitive();
}
