// Camera and pass constants, packed by semisynth_gl/render/constants.py: one block for all shaders.

layout(std140, binding = 0) uniform Constants {
    mat4 clip_from_view;
    vec2 centre_px;          // principal point of the eye whose view is drawn, or that passes for two views look up
    vec2 focal_px;           // focal lengths of that eye, in x and y
    float focal_baseline;    // focal length in x times baseline, px m
    float doffs_px;
    float near_m;
    float other_from_own;    // passes for two views: -1 if their own view is left (x_right = x_left - d), +1 if right
    float least_px;          // only larger disparities are valid: 0, or -LARGEST if disparities are signed
};

// Values of masks, as in semisynth_gl/frame/channels.py.
const uint VISIBLE = 255u;
const uint OCCLUDED = 128u;
const uint OUTSIDE = 0u;

// Larger values mean infinity.
const float LARGEST = 3e38;

// Depth, near / Z, of the sky, which is behind everything, and smallest depth of everything else. They are macros,
// since some compilers accept no function call as the value of a global constant.
#define SKY_DEPTH uintBitsToFloat(0x0D800000u)  // 2^-100
#define LEAST_DEPTH uintBitsToFloat(0x0F000000u)  // 2^-97
