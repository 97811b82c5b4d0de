#version 450 core
// One triangle that covers the image, at depth 0, infinitely far away.

void main() {
    const vec2 CORNERS[3] = vec2[3](vec2(-1.0, -1.0), vec2(3.0, -1.0), vec2(-1.0, 3.0));
    gl_Position = vec4(CORNERS[gl_VertexID], 0.0, 1.0);
}
