// What the passes that make masks have in common: places in the other view, disparities there, and what hides a point.
//
// The includer includes common_constants.glsl before this file.

// How far the other view's surface may be from the point's disparity between two pixels of one smooth surface.
const float BEND_PX = 0.02;
const float BEND_RELATIVE = 0.01;
// Change of disparity from pixel to pixel that passes for one surface without a look at its triangles.
const float STEEPEST = 2.0;
// How much nearer a surface must be to hide a point: what float32 leaves uncertain.
const float ROUNDING_PX = 1e-3;
const float ROUNDING_RELATIVE = 2e-6;

// Where the other eye would see a point, in its columns.
float target_of(float column, float disparity_px) {
    precise float target = column + other_from_own * disparity_px;
    return target;
}

// No disparity is smaller: that of what is infinitely far away, or the end of the valid ones.
float far_px() {
    return max(least_px, -doffs_px);
}

float or_far(float disparity_px) {
    return disparity_px > LARGEST ? far_px() : disparity_px;
}

// Whether one surface with the point on it goes from a pixel to the next: along the row of a plane, disparity is linear.
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
