// The triangles of all models, and the instances of a scene, by their numbers.
//
// Both are textures of four components, since llvmpipe reads a storage buffer number by number. Include
// common_constants.glsl before this file.

struct Instance {
    vec4 view_from_model_x;   // rows, relative to the eye whose surfaces are looked up
    vec4 view_from_model_y;
    vec4 view_from_model_z;
};

layout(binding = 4) uniform usampler2D triangle_corners;  // three texels a triangle; see corner_bits
layout(binding = 5) uniform usampler2D instance_rows;     // three texels an instance: the rows of view_from_model

const uint PER_ROW = 1024u;  // triangles or instances in a row of the texture

Instance instance_at(uint number) {
    ivec2 at = ivec2(3u * (number % PER_ROW), number / PER_ROW);
    return Instance(uintBitsToFloat(texelFetch(instance_rows, at, 0)),
                    uintBitsToFloat(texelFetch(instance_rows, at + ivec2(1, 0), 0)),
                    uintBitsToFloat(texelFetch(instance_rows, at + ivec2(2, 0), 0)));
}

// Corner k of a triangle: xyz are the bits of its position as floats, in model units. w is the number of the triangle
// across the edge to the next corner.
uvec4 corner_bits(uint triangle, int k) {
    return texelFetch(triangle_corners, ivec2(3u * (triangle % PER_ROW) + uint(k), triangle / PER_ROW), 0);
}

vec4 position_of(uvec4 bits) {
    return vec4(uintBitsToFloat(bits.xyz), 1.0);
}

vec3 to_view(Instance instance, vec4 position) {
    return vec3(dot(instance.view_from_model_x, position), dot(instance.view_from_model_y, position),
                dot(instance.view_from_model_z, position));
}

// The unit normal of a triangle's plane, towards the eye. The edges are differences in model units, where corners are
// exact. Differences in the view frame would be rounded at the size of the distance from the eye.
vec3 normal_of(Instance instance, uint triangle) {
    vec4 a = position_of(corner_bits(triangle, 0));
    vec3 first = normalize(to_view(instance, position_of(corner_bits(triangle, 1)) - a));
    vec3 second = normalize(to_view(instance, position_of(corner_bits(triangle, 2)) - a));
    vec3 normal = normalize(cross(first, second));
    return dot(normal, to_view(instance, a)) > 0.0 ? -normal : normal;
}

// 1 / Z of a triangle's plane at a pixel position: n . ray / n . a.
float inverse_depth_at(vec3 a, vec3 b, vec3 c, vec2 pixel) {
    vec3 normal = cross(b - a, c - a);
    return dot(normal, vec3((pixel - centre_px) / focal_px, 1.0)) / dot(normal, a);
}
