#version 450 core
// The disparity of a left view from its 1 / Z. Several pairs may share the view, each with its own f B.

#include "common_constants.glsl"
#include "common_disparity.glsl"

layout(binding = 0) uniform sampler2D inverse_depth;  // negative where nothing is drawn

layout(location = 0) out float disparity_px;

void main() {
    float here = texelFetch(inverse_depth, ivec2(gl_FragCoord.xy), 0).r;
    disparity_px = here < 0.0 ? INVALID : disparity_at(here);
}
