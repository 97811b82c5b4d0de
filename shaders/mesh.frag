#version 450 core
// COLOUR: from the patch atlas and nothing else. TRUTH: planar depth. SURFACE: which triangle of which instance.

in vec2 patch_coordinate;
flat in int patch_layer;
flat in int scene_instance;

#ifdef COLOUR
uniform sampler2DArray atlas;
uniform bool mirror;

layout(location = COLOUR) out vec4 colour;

vec4 patch_colour() {
    vec2 side_texels = vec2(textureSize(atlas, 0).xy);
    // The mip level is taken from the unfolded coordinate: folding it by mirroring has no derivative at the fold.
    vec2 dx = dFdx(patch_coordinate) * side_texels;
    vec2 dy = dFdy(patch_coordinate) * side_texels;
    float lod = 0.5 * log2(max(max(dot(dx, dx), dot(dy, dy)), 1e-12));
    // One texel a pixel must come out bit for bit, so rounding errors of the derivatives may not mix in the next level.
    lod = lod < 0.001 ? 0.0 : lod;

    // Drivers floor the position between texels to a multiple of 1/256; rounding it first keeps a position that is
    // 1e-5 below a texel's centre from taking 1/256 of its neighbour.
    vec2 texel = round((patch_coordinate * side_texels - 0.5) * 256.0) / 256.0 + 0.5;
    vec2 folded = texel / side_texels;
    if (mirror) {
        folded = 1.0 - abs(mod(folded, 2.0) - 1.0);
    }
    return textureLod(atlas, vec3(folded, float(patch_layer)), lod);
}
#endif

#ifdef TRUTH
layout(location = TRUTH) out float depth_m;
#endif

#ifdef SURFACE
layout(location = SURFACE) out uvec2 surface;  // instance, triangle
#endif

void main() {
#ifdef COLOUR
    colour = patch_colour();
#endif
#ifdef TRUTH
    // 1/w is linear on the screen, so the rasteriser interpolates it without a division.
    depth_m = 1.0 / gl_FragCoord.w;
#endif
#ifdef SURFACE
    surface = uvec2(scene_instance, gl_PrimitiveID);
#endif
}
