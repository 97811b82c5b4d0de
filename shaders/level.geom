#version 450 core
// Draws each triangle to its layer.

layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;

in vec2 corner_coordinate[];
flat in int corner_layer[];

out vec2 patch_coordinate;
flat out int patch_layer;

void main() {
    for (int corner = 0; corner < 3; ++corner) {
        patch_coordinate = corner_coordinate[corner];
        patch_layer = corner_layer[corner];
        gl_Layer = corner_layer[corner];
        gl_Position = gl_in[corner].gl_Position;
        EmitVertex();
    }
    EndPrimitive();
}
