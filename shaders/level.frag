#version 450 core
// A texel of a patch at half its size: the mean of four texels, or an approximation by the filter if a side is odd.

in vec2 patch_coordinate;
flat in int patch_layer;

layout(binding = 0) uniform sampler2DArray atlas;  // its base level is the level to halve

layout(location = 0) out vec4 colour;

void main() {
    colour = texture(atlas, vec3(patch_coordinate, float(patch_layer)));
}
