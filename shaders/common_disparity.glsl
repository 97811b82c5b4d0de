// Disparity d = f B / Z - doffs of a depth attachment's value; 0 there means that nothing was drawn.

uniform float focal_baseline;  // px m
uniform float doffs_px;

const float INVALID = uintBitsToFloat(0x7F800000u);  // +inf

float disparity_of(float depth_m) {
    float disparity_px = focal_baseline / depth_m - doffs_px;
    return depth_m > 0.0 && disparity_px > 0.0 ? disparity_px : INVALID;
}
