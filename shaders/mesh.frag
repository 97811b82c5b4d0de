#version 450 core
// COLOUR: from the patch atlas and nothing else, with up to most_samples where it is ANISOTROPIC, with one component where
// it is GREY, and multiplied by light_on() where it is LIT. The rest is truth: DISPARITY, or INVERSE_DEPTH (1 / Z) from
// which several cameras' disparities follow, DEPTH (planar), INSTANCES (ids from 1), SKY, NORMALS (of the triangle, towards
// the camera) and SURFACE (which triangle of which instance). SNAPPED is the number of steps in a pixel to which the driver
// moves the corners of triangles.

#include "common_constants.glsl"

in vec2 patch_coordinate;
flat in int patch_layer;
flat in int scene_instance;
flat in int scene_triangle;

// 1 / Z at the pixel's centre. It is linear on the screen, and the rasteriser interpolates it without a division.
#ifdef SNAPPED
in vec3 point;

// GPUs move corners to multiples of 1 / SNAPPED px first, so they show at a pixel's centre what lies up to half a step
// beside it. How far that is follows from the point; the bound leaves room for rounding, and keeps slivers, whose points
// are badly known, from being carried off.
float inverse_depth_here() {
    precise vec2 ray = (gl_FragCoord.xy - 0.5 - centre_px) / focal_px;
    precise vec2 off_px = focal_px * fma(ray, vec2(point.z), -point.xy) / point.z;
    const float most_px = 0.53 / float(SNAPPED);
    vec2 change = vec2(dFdx(gl_FragCoord.w), dFdy(gl_FragCoord.w));
    precise float here = gl_FragCoord.w + dot(change, clamp(off_px, -most_px, most_px));
    // Beside the horizon of a ground, a step leads beyond infinity.
    return max(here, 1e-30);
}
#else
#define inverse_depth_here() gl_FragCoord.w
#endif

#ifdef COLOUR
layout(binding = 0) uniform sampler2DArray atlas;

#ifdef GREY
#define Colour float
#define seen(texel) (texel).r
#else
#define Colour vec4
#define seen(texel) (texel)
#endif

layout(location = COLOUR) out Colour colour;

#ifdef ANISOTROPIC
// Not a constant: llvmpipe would unroll the loop, and take the most samples for all pixels.
uniform float most_samples;
#endif

Colour patch_colour() {
    vec2 side_texels = vec2(textureSize(atlas, 0).xy);
    // Drivers floor the position between texels to a multiple of 1/256; rounding it first keeps a position that is
    // 1e-5 below a texel's centre from taking 1/256 of its neighbour.
    vec2 position = (patch_coordinate * side_texels - 0.5) * 256.0;
    vec2 to_step = (round(position) - position) / (256.0 * side_texels);
#ifndef ANISOTROPIC
    return seen(texture(atlas, vec3(patch_coordinate + to_step, float(patch_layer))));
#else
    vec2 dx = dFdx(patch_coordinate), dy = dFdy(patch_coordinate);
    float x_texels = length(dx * side_texels), y_texels = length(dy * side_texels);
    float longer = max(max(x_texels, y_texels), 1e-6);
    // A pixel that covers many texels in one direction and few in the other is sampled several times along the longer
    // one. The driver's own anisotropic filter is not used: its results differ, with stray dots on llvmpipe.
    // One texel a pixel must come out bit for bit, so errors of the derivatives may neither add a sample nor mix in the next
    // level. OpenGL does not bound these errors; near the end of a patch of 2048 texels, they reach 1e-3.
    float taps = clamp(ceil(longer / max(min(x_texels, y_texels), 1.0) - 0.01), 1.0, most_samples);
    float lod = log2(longer / taps);
    lod = lod < 0.003 ? 0.0 : lod;
    vec2 along = x_texels > y_texels ? dx : dy;
    Colour sum = Colour(0.0);
    for (float tap = 0.5; tap < taps; tap += 1.0) {
        vec2 offset = taps > 1.0 ? along * (tap / taps - 0.5) : to_step;
        sum += seen(textureLod(atlas, vec3(patch_coordinate + offset, float(patch_layer)), lod));
    }
    return sum / taps;
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
#ifdef COLOUR
    colour = patch_colour();
#endif
#ifdef LIT
    vec3 over_depth = over_depth_at(gl_FragCoord.xy, gl_FragCoord.w);
    vec3 lit_point = over_depth / gl_FragCoord.w;
    vec3 lit_normal = cross(dFdx(lit_point), dFdy(lit_point));
    colour *= light_on(over_depth, gl_FragCoord.w, lit_normal, gl_FragCoord.z < LEAST_DEPTH);
#endif
#if defined(DISPARITY) || defined(INVERSE_DEPTH) || defined(DEPTH) || defined(SKY)
    bool is_sky = gl_FragCoord.z < LEAST_DEPTH;
#endif
#if defined(DISPARITY) || defined(INVERSE_DEPTH) || defined(DEPTH)
    // Derivatives are taken in all pixels alike, whether they show the sky or not.
    float here = inverse_depth_here();
#endif
#ifdef DISPARITY
    disparity_px = disparity_at(is_sky ? 0.0 : here);
#endif
#ifdef INVERSE_DEPTH
    inverse_depth = is_sky ? 0.0 : here;
#endif
#ifdef DEPTH
    depth_m = is_sky ? uintBitsToFloat(0x7F800000u) : 1.0 / here;
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
