#version 450 core
// Colour and truth of a surface. These outputs are optional; if defined, their value is the output's location:
// COLOUR, only from the patch atlas; DISPARITY; INVERSE_DEPTH (1 / Z), from which disparities of several cameras are
// computed; DEPTH (planar); INSTANCES (ids from 1); SKY; NORMALS (of the triangle, towards the camera); SURFACE
// (instance and triangle). For COLOUR, ANISOTROPIC takes up to most_samples samples, GREY writes one component, and LIT
// multiplies by light_on(). SNAPPED is N if the driver rounds corners of triangles to multiples of 1 / N px.

#include "common_constants.glsl"

in vec2 patch_coordinate;
flat in int patch_layer;
flat in int scene_instance;
flat in int scene_triangle;

// 1 / Z at the pixel's centre. It is linear on the screen, and the rasteriser interpolates it without a division.
#ifdef SNAPPED
in vec3 point;

// Rounded corners move a triangle by up to half a step, so a pixel gets the values of a point beside its centre.
// offset_px is the centre minus that point's projection, and 1 / Z at the centre is w + grad(w) . offset_px. Its limit,
// half a step and 6 % for rounding, prevents large corrections on slivers, whose interpolated points are inexact.
float inverse_depth_here() {
    precise vec2 ray = (gl_FragCoord.xy - 0.5 - centre_px) / focal_px;
    precise vec2 offset_px = focal_px * fma(ray, vec2(point.z), -point.xy) / point.z;
    const float most_px = 0.53 / float(SNAPPED);
    vec2 gradient = vec2(dFdx(gl_FragCoord.w), dFdy(gl_FragCoord.w));
    precise float here = gl_FragCoord.w + dot(gradient, clamp(offset_px, -most_px, most_px));
    // At the horizon of a ground, 1 / Z may become 0 or negative.
    return max(here, 1e-30);
}
#else
#define inverse_depth_here() gl_FragCoord.w
#endif

#ifdef COLOUR
layout(binding = 0) uniform sampler2DArray atlas;

#ifdef GREY
#define Colour float
#define components(texel) (texel).r
#else
#define Colour vec4
#define components(texel) (texel)
#endif

layout(location = COLOUR) out Colour colour;

#ifdef ANISOTROPIC
// Not a constant: llvmpipe would unroll the loop, and take most_samples in all pixels.
uniform float most_samples;
// Tolerances of derivatives, so that one texel per pixel comes out bit for bit: the errors may neither add a sample nor
// mix in the next level. OpenGL does not bound them; near the end of a patch of 2048 texels they reach 1e-3.
const float RATIO_TOLERANCE = 0.01;  // of the ratio of the longer and the shorter direction
const float LOD_TOLERANCE = 0.003;   // of the mipmap level
#endif

Colour patch_colour() {
    vec2 side_texels = vec2(textureSize(atlas, 0).xy);
    // Drivers round positions between texels down to multiples of 1/256 texel. A position 1e-5 below a texel's centre
    // would mix in 1/256 of the neighbouring texel, so round to the nearest multiple first.
    vec2 steps = (patch_coordinate * side_texels - 0.5) * 256.0;
    vec2 to_nearest_step = (round(steps) - steps) / (256.0 * side_texels);
#ifndef ANISOTROPIC
    return components(texture(atlas, vec3(patch_coordinate + to_nearest_step, float(patch_layer))));
#else
    vec2 dx = dFdx(patch_coordinate), dy = dFdy(patch_coordinate);
    float x_texels = length(dx * side_texels), y_texels = length(dy * side_texels);
    float longer = max(max(x_texels, y_texels), 1e-6);
    // A pixel that covers many texels in one direction and few in the other is sampled several times along the longer
    // direction. The driver's anisotropic filter is not used: on llvmpipe, it makes stray dots.
    float samples = clamp(ceil(longer / max(min(x_texels, y_texels), 1.0) - RATIO_TOLERANCE), 1.0, most_samples);
    float lod = log2(longer / samples);
    lod = lod < LOD_TOLERANCE ? 0.0 : lod;
    vec2 along = x_texels > y_texels ? dx : dy;
    Colour sum = Colour(0.0);
    for (float middle = 0.5; middle < samples; middle += 1.0) {
        vec2 offset = samples > 1.0 ? along * (middle / samples - 0.5) : to_nearest_step;
        sum += components(textureLod(atlas, vec3(patch_coordinate + offset, float(patch_layer)), lod));
    }
    return sum / samples;
#endif
}
#endif

#ifdef LIT
#include "common_projector.glsl"
#endif
#ifdef DISPARITY
#include "common_disparity.glsl"
layout(location = DISPARITY) out float disparity_px;
#endif
#ifdef INVERSE_DEPTH
layout(location = INVERSE_DEPTH) out float inverse_depth;
#endif
#ifdef DEPTH
layout(location = DEPTH) out float depth_m;
#endif
#ifdef INSTANCES
layout(location = INSTANCES) out uint instance_id;
#endif
#ifdef SKY
layout(location = SKY) out uint sky;
#endif
#ifdef NORMALS
#include "common_triangles.glsl"
layout(location = NORMALS) out vec4 normal;
#endif
#ifdef SURFACE
layout(location = SURFACE) out uvec2 surface;  // instance, triangle
#endif

void main() {
    bool is_sky = gl_FragCoord.z < LEAST_DEPTH;
    // Not within a branch: its derivatives need the neighbouring pixels, too.
    float here = inverse_depth_here();
#ifdef COLOUR
    colour = patch_colour();
#endif
#ifdef LIT
    vec3 over_depth = point_over_depth(gl_FragCoord.xy, gl_FragCoord.w);
    vec3 lit_point = over_depth / gl_FragCoord.w;
    vec3 lit_normal = cross(dFdx(lit_point), dFdy(lit_point));
    colour *= light_on(over_depth, gl_FragCoord.w, lit_normal, is_sky);
#endif
#ifdef DISPARITY
    disparity_px = disparity_at(is_sky ? 0.0 : here);
#endif
#ifdef INVERSE_DEPTH
    inverse_depth = is_sky ? 0.0 : here;
#endif
#ifdef DEPTH
    depth_m = is_sky ? INFINITY : 1.0 / here;
#endif
#ifdef SKY
    sky = is_sky ? 255u : 0u;
#endif
#ifdef INSTANCES
    instance_id = uint(scene_instance) + 1u;
#endif
#ifdef NORMALS
    normal = vec4(normal_of(instance_at(uint(scene_instance)), uint(scene_triangle)), 0.0);
#endif
#ifdef SURFACE
    surface = uvec2(scene_instance, scene_triangle);
#endif
}
