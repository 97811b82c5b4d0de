// Disparity d = f B / Z - doffs, px; where it is not positive there is none, unless disparities are signed.

// The includer includes common_constants.glsl before this file.

const float INVALID = uintBitsToFloat(0x7F800000u);  // +inf

float or_invalid(float disparity_px) {
    return disparity_px > least_px ? disparity_px : INVALID;
}

// One rounding instead of two: f B / Z may be far larger than the disparity that doffs leaves of it.
float disparity_at(float inverse_depth) {
    return or_invalid(fma(focal_baseline, inverse_depth, -doffs_px));
}
