// Disparity d = f B / Z - doffs, px. Unless disparities are signed, only positive disparities are valid.

// The includer includes common_constants.glsl before this file.

#define INVALID uintBitsToFloat(0x7F800000u)  // +inf

float or_invalid(float disparity_px) {
    return disparity_px > least_px ? disparity_px : INVALID;
}

// fma rounds once instead of twice: f B / Z may be far larger than the disparity that remains after subtracting doffs.
float disparity_at(float inverse_depth) {
    precise float disparity_px = fma(focal_baseline, inverse_depth, -doffs_px);
    return or_invalid(disparity_px);
}
