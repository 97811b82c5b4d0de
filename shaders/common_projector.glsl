// The light on a surface: ambient light, and the pattern of a projector where it reaches the surface.

// Packed by semisynth_gl/render/projector_light.py.
layout(std140, binding = 1) uniform ProjectedLight {
    mat4 projector_from_window;  // from (x, y, 1, 1 / Z) in the window to P / Z, with P in the projector's frame
    vec2 middle_px;              // middle of the pattern
    float projector_focal_px;
    float power;
    float ambient;
};

layout(binding = 2) uniform sampler2D pattern;
layout(binding = 3) uniform sampler2D projector_depth_m;  // of the surfaces that the projector's pixels light

// Relative tolerance of depths, which come from different matrices.
const float SAME_DEPTH = 1.0001;

// P / Z, where P is a point in the projector's frame, and Z its depth for the eye, at a position in the eye's window.
vec3 point_over_depth(vec2 window_px, float inverse_depth) {
    return (projector_from_window * vec4(window_px, 1.0, inverse_depth)).xyz;
}

// ambient + power * pattern * cos(incidence) / distance^2 at this point. The normal, in the projector's frame, may have
// any length.
float light_on(vec3 over_depth, float inverse_depth, vec3 normal, bool is_sky) {
    vec3 point = over_depth / inverse_depth;
    vec2 pattern_px = projector_focal_px * over_depth.xy / over_depth.z + middle_px;
    vec2 coordinate = (pattern_px + 0.5) / vec2(textureSize(pattern, 0));
    // The point lies between the centres of four pixels of the projector. A plane or a surface that bulges towards the
    // projector is nowhere deeper between them than at the deepest of the four, so no surface shades itself.
    vec4 depths_m = textureGather(projector_depth_m, coordinate);
    float deepest_m = max(max(depths_m.x, depths_m.y), max(depths_m.z, depths_m.w));
    bool inside = all(greaterThanEqual(coordinate, vec2(0.0))) && all(lessThan(coordinate, vec2(1.0)));
    bool reached = over_depth.z > 0.0 && inside && point.z <= deepest_m * SAME_DEPTH;
    float distance_squared = dot(point, point);
    float cosine = abs(dot(normal, point)) / max(sqrt(dot(normal, normal) * distance_squared), 1e-30);
    // If eye and projector are on opposite sides of a sheet, the eye does not see the lit side. The vector from the eye
    // to the point is P minus the eye's position, the last column of the matrix.
    vec3 from_eye = over_depth - projector_from_window[3].xyz * inverse_depth;
    bool same_side = dot(normal, point) * dot(normal, from_eye) > 0.0;
    // The sky is too far away to be lit.
    bool lit = reached && same_side && !is_sky;
    return ambient + (lit ? power * textureLod(pattern, coordinate, 0.0).r * cosine / distance_squared : 0.0);
}
