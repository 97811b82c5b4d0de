#version 450 core
// mesh.vert without its texture, with planar depth as a varying. Only benchmarks/alternatives.py draws with it.

#include "common_constants.glsl"

layout(location = 0) in vec3 position;         // model units
layout(location = 2) in vec4 view_from_model_x;
layout(location = 3) in vec4 view_from_model_y;
layout(location = 4) in vec4 view_from_model_z;
layout(location = 7) in int instance;

out float view_depth_m;
flat out int scene_instance;
flat out int scene_triangle;

#include "common_placement.glsl"

void main() {
    vec3 view = vec3(view_coordinate(view_from_model_x, position), view_coordinate(view_from_model_y, position),
                     view_coordinate(view_from_model_z, position));
    view_depth_m = view.z;
    scene_instance = instance;
    scene_triangle = gl_VertexID;
    gl_Position = clip_from_view * vec4(view, 1.0);
}
