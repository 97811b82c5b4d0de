// Following a surface along an image row, from a pixel that shows it to where it ends.
//
// Depth maps know surfaces at pixel centres only; whether a surface hides a point between two centres is decided here by
// its triangles: from the one that the pixel shows, across shared edges, until the point is reached or the surface turns
// away at its silhouette.

struct Instance {
    vec4 view_from_model_x;   // rows, relative to the other eye
    vec4 view_from_model_y;
    vec4 view_from_model_z;
    uvec4 model;              // first triangle, base vertex
};

layout(std430, binding = 0) readonly buffer Vertices { float vertex[]; };        // x y z u v of each
layout(std430, binding = 1) readonly buffer Indices { uint index[]; };
layout(std430, binding = 2) readonly buffer Neighbours { uint neighbour[]; };    // across the edge from corner k to k + 1
layout(std430, binding = 3) readonly buffer Instances { Instance instances[]; };

uniform float focal_px;
uniform float near_m;
uniform vec2 other_centre_px;    // principal point of the other eye

const uint NO_NEIGHBOUR = 0xFFFFFFFFu;
const int MOST_STEPS = 32;
const float NOT_COVERED = -1.0;

vec3 corner_of(Instance instance, uint triangle, int k) {
    uint at = 5u * (index[3u * (instance.model.x + triangle) + uint(k)] + instance.model.y);
    vec4 position = vec4(vertex[at], vertex[at + 1u], vertex[at + 2u], 1.0);
    return vec3(dot(instance.view_from_model_x, position), dot(instance.view_from_model_y, position),
                dot(instance.view_from_model_z, position));
}

// 1 / Z of a triangle's plane at a pixel position.
float inverse_depth_at(vec3 a, vec3 b, vec3 c, vec2 pixel) {
    vec3 normal = cross(b - a, c - a);
    return dot(normal, vec3((pixel - other_centre_px) / focal_px, 1.0)) / dot(normal, a);
}

// 1 / Z of the surface at (target_x, row), or NOT_COVERED where it ends before.
float surface_at(uvec2 surface, float row, float start_x, float target_x) {
    Instance instance = instances[surface.x];
    uint triangle = surface.y;
    uint came_from = NO_NEIGHBOUR;
    float direction = target_x < start_x ? -1.0 : 1.0;
    float reached_x = start_x;
    for (int step = 0; step < MOST_STEPS; ++step) {
        vec3 corner[3];
        vec2 pixel[3];
        bool in_front = true;
        for (int k = 0; k < 3; ++k) {
            corner[k] = corner_of(instance, triangle, k);
            in_front = in_front && corner[k].z >= near_m;
            pixel[k] = focal_px * corner[k].xy / corner[k].z + other_centre_px;
        }
        // A triangle that crosses the near plane has no outline on the image. Such are walls: they go on.
        if (!in_front) {
            return inverse_depth_at(corner[0], corner[1], corner[2], vec2(target_x, row));
        }
        // Two of the three edges cross the row; leave by the one that is farther on, and not the way in.
        float exit_x = -1e30;
        uint next = NO_NEIGHBOUR;
        for (int k = 0; k < 3; ++k) {
            vec2 from = pixel[k], to = pixel[(k + 1) % 3];
            uint across = neighbour[3u * (instance.model.x + triangle) + uint(k)];
            if ((from.y > row) == (to.y > row) || (across == came_from && across != NO_NEIGHBOUR)) {
                continue;
            }
            float x = direction * mix(from.x, to.x, (row - from.y) / (to.y - from.y));
            if (x > exit_x) {
                exit_x = x;
                next = across;
            }
        }
        if (exit_x >= direction * target_x) {
            return inverse_depth_at(corner[0], corner[1], corner[2], vec2(target_x, row));
        }
        // Behind the silhouette the next triangle lies back under this one.
        if (next == NO_NEIGHBOUR || (step > 0 && exit_x < direction * reached_x)) {
            return NOT_COVERED;
        }
        reached_x = direction * exit_x;
        came_from = triangle;
        triangle = next;
    }
    return NOT_COVERED;
}
