// Disparity d = f B / Z - doffs, px. Unless disparities are signed, only positive disparities are valid.
//
// Include common_constants.glsl before this file.

#define INVALID INFINITY

float or_invalid(float disparity_px) {
    return disparity_px > disparity_floor_px ? disparity_px : INVALID;
}

// fma rounds only its result: f B / Z may be far larger than the difference, and would be rounded more coarsely.
float disparity_at(float inverse_depth) {
    precise float disparity_px = fma(focal_baseline, inverse_depth, -doffs_px);
    return or_invalid(disparity_px);
}
