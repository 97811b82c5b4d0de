// Camera and pass constants, packed by semisynth_gl/render/constants.py: one block for all shaders.

layout(std140, binding = 0) uniform Constants {
    mat4 clip_from_view;
    vec2 centre_px;          // principal point of the eye that is drawn, or whose surfaces are followed
    float focal_px;
    float focal_baseline;    // px m
    float doffs_px;
    float near_m;
    float other_from_own;    // -1 in the left view (x_right = x_left - d), +1 in the right one
};

// What masks say, as in semisynth_gl/frame.py.
const uint VISIBLE = 255u;
const uint OCCLUDED = 128u;
const uint OUTSIDE = 0u;

// Larger is infinite.
const float LARGEST = 3e38;
