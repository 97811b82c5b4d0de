#version 450 core
// COLOUR comes only from the patch atlas. ANISOTROPIC takes up to most_samples of it, GREY has one component, and LIT
// multiplies it by light_on(). The other outputs are truth: DISPARITY; INVERSE_DEPTH (1 / Z), from which disparities of
// several cameras are computed; DEPTH (planar); INSTANCES (ids from 1); SKY; NORMALS (of the triangle, towards the
// camera); SURFACE (instance and triangle). SNAPPED is the number of steps in a pixel to which the driver rounds
// corners of triangles.

#include "common_constants.glsl"

in vec2 patch_coordinate;
flat in int patch_layer;
flat in int scene_instance;
flat in int scene_triangle;

// 1 / Z at the pixel's centre. It is linear on the screen, and the rasteriser interpolates it without a division.
#ifdef SNAPPED
in vec3 point;

// GPUs first round corners to multiples of 1 / SNAPPED px, so a pixel's centre shows a point that lies up to half a
// step beside it. The interpolated point gives this offset. Its limit has a margin for rounding, and prevents large
// corrections on slivers, whose interpolated points are inexact.
float inverse_depth_here() {
    precise vec2 ray = (gl_FragCoord.xy - 0.5 - centre_px) / focal_px;
    precise vec2 off_px = focal_px * fma(ray, vec2(point.z), -point.xy) / point.z;
    const float most_px = 0.53 / float(SNAPPED);
    vec2 change = vec2(dFdx(gl_FragCoord.w), dFdy(gl_FragCoord.w));
    precise float here = gl_FragCoord.w + dot(change, clamp(off_px, -most_px, most_px));
    // Next to the horizon of a ground, the correction may lead to 1 / Z <= 0.
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
// Not a constant: llvmpipe would unroll the loop, and take most_samples in all pixels.
uniform float most_samples;
#endif

Colour patch_colour() {
    vec2 side_texels = vec2(textureSize(atlas, 0).xy);
    // Drivers round the position between texels down to a multiple of 1/256. Without our rounding, a position 1e-5
    // below a texel's centre would mix in 1/256 of the neighbouring texel.
    vec2 position = (patch_coordinate * side_texels - 0.5) * 256.0;
    vec2 to_step = (round(position) - position) / (256.0 * side_texels);
#ifndef ANISOTROPIC
    return seen(texture(atlas, vec3(patch_coordinate + to_step, float(patch_layer))));
#else
    vec2 dx = dFdx(patch_coordinate), dy = dFdy(patch_coordinate);
    float x_texels = length(dx * side_texels), y_texels = length(dy * side_texels);
    float longer = max(max(x_texels, y_texels), 1e-6);
    // A pixel that covers many texels in one direction and few in the other is sampled several times along the longer
    // direction. The driver's own anisotropic filter is not used: it has different results, with stray dots on
    // llvmpipe. One texel per pixel must come out bit for bit, so errors of the derivatives may neither add a sample
    // nor mix in the next level. OpenGL does not bound these errors; near the end of a patch of 2048 texels, they reach
    // 1e-3.
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
    // All pixels compute this, even those of the sky, since it takes derivatives.
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
