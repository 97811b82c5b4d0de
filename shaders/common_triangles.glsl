// The triangles of all models, and the instances of a scene. The includer includes common_constants.glsl before this file.

struct Instance {
    vec4 view_from_model_x;   // rows, relative to the eye whose view is followed
    vec4 view_from_model_y;
    vec4 view_from_model_z;
    uvec4 model;              // first triangle, base vertex
};

layout(std430, binding = 0) readonly buffer Vertices { float vertex[]; };        // x y z u v of each
layout(std430, binding = 1) readonly buffer Indices { uint index[]; };
layout(std430, binding = 2) readonly buffer Neighbours { uint neighbour[]; };    // across the edge from corner k to k + 1
layout(std430, binding = 3) readonly buffer Instances { Instance instances[]; };

// The triangle whose last corner is a vertex, of all models' vertices: see ModelBuffers.
uint triangle_of(Instance instance, int last_corner) {
    return uint(last_corner) - instance.model.y;
}

// One corner of a triangle in model units; w is 1.
vec4 position_of(Instance instance, uint triangle, int k) {
    uint at = 5u * (index[3u * (instance.model.x + triangle) + uint(k)] + instance.model.y);
    return vec4(vertex[at], vertex[at + 1u], vertex[at + 2u], 1.0);
}

vec3 in_view(Instance instance, vec4 position) {
    return vec3(dot(instance.view_from_model_x, position), dot(instance.view_from_model_y, position),
                dot(instance.view_from_model_z, position));
}

vec3 corner_of(Instance instance, uint triangle, int k) {
    return in_view(instance, position_of(instance, triangle, k));
}

// The unit normal of a triangle's plane, towards the eye. Edges are taken in model units, where corners are exact: the
// difference of two corners in view would round in steps of their distance from the eye.
vec3 normal_of(Instance instance, uint triangle) {
    vec4 a = position_of(instance, triangle, 0);
    vec3 first = normalize(in_view(instance, position_of(instance, triangle, 1) - a));
    vec3 second = normalize(in_view(instance, position_of(instance, triangle, 2) - a));
    vec3 normal = normalize(cross(first, second));
    return dot(normal, in_view(instance, a)) > 0.0 ? -normal : normal;
}

// 1 / Z of a triangle's plane at a pixel position.
float inverse_depth_at(vec3 a, vec3 b, vec3 c, vec2 pixel) {
    vec3 normal = cross(b - a, c - a);
    return dot(normal, vec3((pixel - centre_px) / focal_px, 1.0)) / dot(normal, a);
}
