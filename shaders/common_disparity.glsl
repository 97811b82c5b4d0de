// Disparity d = f B / Z - doffs, px; where it is not positive there is none, unless disparities are signed.

// The includer includes common_constants.glsl before this file.

#define INVALID uintBitsToFloat(0x7F800000u)  // +inf

float or_invalid(float disparity_px) {
    return disparity_px > least_px ? disparity_px : INVALID;
}

// One rounding instead of two: f B / Z may be far larger than the disparity that doffs leaves of it.
float disparity_at(float inverse_depth) {
    precise float disparity_px = fma(focal_baseline, inverse_depth, -doffs_px);
    return or_invalid(disparity_px);
}
