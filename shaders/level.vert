#version 450 core
// For each instance, a fan of two triangles that covers the image. The instance's number is the layer to draw to.

out vec2 corner_coordinate;
flat out int corner_layer;

void main() {
    const vec2 CORNERS[4] = vec2[4](vec2(0.0, 0.0), vec2(1.0, 0.0), vec2(1.0, 1.0), vec2(0.0, 1.0));
    corner_coordinate = CORNERS[gl_VertexID];
    corner_layer = gl_InstanceID;
    gl_Position = vec4(corner_coordinate * 2.0 - 1.0, 0.0, 1.0);
}
