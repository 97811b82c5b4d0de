#version 450 core
// For each pixel, the mean of the FACTOR x FACTOR pixels that supersampling has drawn.

layout(binding = 0) uniform sampler2D fine;

layout(location = 0) out vec4 colour;

void main() {
    ivec2 corner = ivec2(gl_FragCoord.xy) * FACTOR;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < FACTOR; ++y) {
        for (int x = 0; x < FACTOR; ++x) {
            sum += texelFetch(fine, corner + ivec2(x, y), 0);
        }
    }
    colour = sum / float(FACTOR * FACTOR);
}
