// Camera and pass constants, packed by semisynth_gl/render/constants.py: one block for all shaders.

layout(std140, binding = 0) uniform Constants {
    mat4 clip_from_view;
    // Principal point and focal lengths (x, y) of the eye whose view is made. In the visibility and correspondence
    // passes, and in all that they include, of the other eye, in whose view they look points up.
    vec2 centre_px;
    vec2 focal_px;
    float focal_baseline;  // f B: focal length in x times baseline, px m
    float doffs_px;
    float near_m;
    float disparity_sign;      // s in x_other = x_own + s d, for the same passes: -1 if their own eye is the left one
    float disparity_floor_px;  // only larger disparities are valid: 0, or -LARGEST if disparities are signed
};

// Values of masks, as in semisynth_gl/frame/channels.py.
const uint VISIBLE = 255u;
const uint OCCLUDED = 128u;
const uint OUTSIDE = 0u;

// Larger values mean infinity.
const float LARGEST = 3e38;

// Macros, since some compilers accept no function call as the value of a global constant.
#define INFINITY uintBitsToFloat(0x7F800000u)
// Depth, near / Z, of the sky, and the smallest depth of everything else, which is in front of the sky.
#define SKY_DEPTH uintBitsToFloat(0x0D800000u)  // 2^-100
#define LEAST_DEPTH uintBitsToFloat(0x0F000000u)  // 2^-97
