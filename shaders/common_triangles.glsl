// The triangles of all models, and the instances of a scene. The includer includes common_constants.glsl before this
// file.
//
// Both are in textures of four components, since llvmpipe reads the numbers of a storage buffer one by one.

struct Instance {
    vec4 view_from_model_x;   // rows, relative to the eye whose surfaces are in the textures
    vec4 view_from_model_y;
    vec4 view_from_model_z;
};

layout(binding = 4) uniform usampler2D triangle_corners;  // three texels each; see corner_bits
layout(binding = 5) uniform usampler2D instance_rows;     // three texels each, the rows of view_from_model

const uint PER_ROW = 1024u;  // triangles, or instances, in a row of the texture

Instance instance_at(uint number) {
    ivec2 at = ivec2(3u * (number % PER_ROW), number / PER_ROW);
    return Instance(uintBitsToFloat(texelFetch(instance_rows, at, 0)),
                    uintBitsToFloat(texelFetch(instance_rows, at + ivec2(1, 0), 0)),
                    uintBitsToFloat(texelFetch(instance_rows, at + ivec2(2, 0), 0)));
}

// One corner of a triangle: the bits of its position in model units, and the triangle across the edge to the next
// corner.
uvec4 corner_bits(uint triangle, int k) {
    return texelFetch(triangle_corners, ivec2(3u * (triangle % PER_ROW) + uint(k), triangle / PER_ROW), 0);
}

vec4 position_of(uvec4 bits) {
    return vec4(uintBitsToFloat(bits.xyz), 1.0);
}

vec3 in_view(Instance instance, vec4 position) {
    return vec3(dot(instance.view_from_model_x, position), dot(instance.view_from_model_y, position),
                dot(instance.view_from_model_z, position));
}

vec3 corner_of(Instance instance, uint triangle, int k) {
    return in_view(instance, position_of(corner_bits(triangle, k)));
}

// The unit normal of a triangle's plane, towards the eye. The edges are subtracted in model units, where corners are
// exact: the difference of two corners in view would round in steps of their distance from the eye.
vec3 normal_of(Instance instance, uint triangle) {
    vec4 a = position_of(corner_bits(triangle, 0));
    vec3 first = normalize(in_view(instance, position_of(corner_bits(triangle, 1)) - a));
    vec3 second = normalize(in_view(instance, position_of(corner_bits(triangle, 2)) - a));
    vec3 normal = normalize(cross(first, second));
    return dot(normal, in_view(instance, a)) > 0.0 ? -normal : normal;
}

// 1 / Z of a triangle's plane at a pixel position.
float inverse_depth_at(vec3 a, vec3 b, vec3 c, vec2 pixel) {
    vec3 normal = cross(b - a, c - a);
    return dot(normal, vec3((pixel - centre_px) / focal_px, 1.0)) / dot(normal, a);
}
