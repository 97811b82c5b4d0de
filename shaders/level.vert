#version 450 core
// For each instance, a fan of two triangles that covers the image. The instance's number is the layer to draw to.

out vec2 corner_coordinate;
flat out int corner_layer;

void main() {
    corner_coordinate = vec2((gl_VertexID ^ gl_VertexID >> 1) & 1, gl_VertexID >> 1);
    corner_layer = gl_InstanceID;
    gl_Position = vec4(corner_coordinate * 2.0 - 1.0, 0.0, 1.0);
}
