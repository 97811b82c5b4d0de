#version 450 core
// Places one instance of a model in one eye's view.

#include "common_constants.glsl"

layout(location = 0) in vec3 position;         // model units
layout(location = 1) in vec2 uv;
// Rows of view_from_model, composed in float64 on the CPU. The view frame is that of this eye.
layout(location = 2) in vec4 view_from_model_x;
layout(location = 3) in vec4 view_from_model_y;
layout(location = 4) in vec4 view_from_model_z;
layout(location = 5) in vec4 patch_from_uv;    // scale.xy, offset.xy
layout(location = 6) in int layer;
layout(location = 7) in int instance;          // the instance's index in the scene
layout(location = 8) in int sky;               // 1 if the instance is infinitely far away

out vec2 patch_coordinate;
flat out int patch_layer;
flat out int scene_instance;
flat out int scene_triangle;  // from the triangle's last corner, which has the triangle's number; see SceneBuffers
out vec3 point;               // in the view frame

// Several programs draw the same triangles, and must write the same depths.
invariant gl_Position;

#include "common_placement.glsl"

void main() {
    point = vec3(view_coordinate(view_from_model_x, position), view_coordinate(view_from_model_y, position),
                 view_coordinate(view_from_model_z, position));
    patch_coordinate = uv * patch_from_uv.xy + patch_from_uv.zw;
    patch_layer = layer;
    scene_instance = instance;
    scene_triangle = gl_VertexID;
    gl_Position = clip_from_view * vec4(point, 1.0);
    if (sky != 0) {
        gl_Position.z = SKY_DEPTH * gl_Position.w;
    }
}
