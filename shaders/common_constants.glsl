// Camera and pass constants, packed by semisynth_gl/render/constants.py: one block for all shaders.

layout(std140, binding = 0) uniform Constants {
    mat4 clip_from_view;
    vec2 centre_px;          // principal point of the eye that is drawn, or whose surfaces are followed
    vec2 focal_px;           // of that eye, in x and y
    float focal_baseline;    // focal length in x times baseline, px m
    float doffs_px;
    float near_m;
    float other_from_own;    // -1 in the left view (x_right = x_left - d), +1 in the right one
    float least_px;          // only larger disparities are valid: 0, or -LARGEST where disparities are signed
};

// Values of masks, as in semisynth_gl/frame/frame.py.
const uint VISIBLE = 255u;
const uint OCCLUDED = 128u;
const uint OUTSIDE = 0u;

// Largest finite value; larger values count as infinite.
const float LARGEST = 3e38;

// Depth, near / Z, of the sky, which is behind everything, and smallest depth of everything else. They are not constants,
// since some compilers accept no function call as a global constant's value.
#define SKY_DEPTH uintBitsToFloat(0x0D800000u)  // 2^-100
#define LEAST_DEPTH uintBitsToFloat(0x0F000000u)  // 2^-97
