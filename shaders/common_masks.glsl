// Functions that the passes for masks share: places in the other view, disparities there, and whether a point is hidden.
//
// The includer includes common_constants.glsl before this file.

// Largest difference, between two pixels of one smooth surface, of the other view's disparity from the point's.
const float BEND_PX = 0.02;
const float BEND_RELATIVE = 0.01;
// Largest change of disparity from pixel to pixel that counts as one surface without a look at its triangles.
const float STEEPEST = 2.0;
// How much nearer a surface must be to hide a point: the uncertainty of float32.
const float ROUNDING_PX = 1e-3;
const float ROUNDING_RELATIVE = 2e-6;

// Where the other eye would see a point, in its columns.
float target_of(float column, float disparity_px) {
    precise float target = column + other_from_own * disparity_px;
    return target;
}

// Smallest disparity: that of points at infinity, or the lower end of the valid disparities.
float far_px() {
    return max(least_px, -doffs_px);
}

float or_far(float disparity_px) {
    return disparity_px > LARGEST ? far_px() : disparity_px;
}

// Whether the surface of the point continues from a pixel to the next: along a row, a plane's disparity is linear.
bool goes_on(float disparity_px, float between, vec2 beside) {
    precise float off = abs(mix(beside.x, beside.y, between) - disparity_px), step = abs(beside.y - beside.x);
    precise float most = BEND_PX + BEND_RELATIVE * step;
    return off < most && step < STEEPEST;
}

// Whether a surface of this 1 / Z is nearer than a point.
bool is_before(float inverse_depth, float disparity_px) {
    float rounding_px = ROUNDING_PX + ROUNDING_RELATIVE * focal_baseline * abs(inverse_depth);
    return inverse_depth > 0.0 && focal_baseline * inverse_depth - doffs_px > disparity_px + rounding_px;
}
