#version 450 core
// A point for each strip; see edges.geom.

void main() {
    gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
}
