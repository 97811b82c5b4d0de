// The light on a surface: ambient light, and the pattern of a projector where it reaches the surface.

// Packed by semisynth_gl/render/projector_light.py.
layout(std140, binding = 1) uniform ProjectedLight {
    mat4 projector_from_window;  // from (x, y, 1, 1 / Z) in the window to (point in the projector's frame) / Z
    vec2 middle_px;              // middle of the pattern
    float projector_focal_px;
    float power;
    float ambient;
};

layout(binding = 2) uniform sampler2D pattern;
layout(binding = 3) uniform sampler2D reached_m;  // depth of the surface that each of the projector's pixels reaches

// Margin for rounding: depths that come from different matrices differ.
const float SAME_DEPTH = 1.0001;

// A point in the projector's frame, divided by Z in the eye's frame, from its position in the window and 1 / Z.
vec3 over_depth_at(vec2 window_px, float inverse_depth) {
    return (projector_from_window * vec4(window_px, 1.0, inverse_depth)).xyz;
}

// The light on that point of a surface. The normal, in the projector's frame, may have any length.
float light_on(vec3 over_depth, float inverse_depth, vec3 normal, bool is_sky) {
    vec3 point = over_depth / inverse_depth;
    vec2 place_px = projector_focal_px * over_depth.xy / over_depth.z + middle_px;
    vec2 size = vec2(textureSize(pattern, 0));
    vec2 place = (place_px + 0.5) / size;
    // The point lies between four centres of the projector's pixels. Between them, a plane or a surface that bulges
    // towards the projector is nowhere deeper than at the deepest of the four, so no surface shades itself.
    vec4 around = textureGather(reached_m, place);
    float farthest_m = max(max(around.x, around.y), max(around.z, around.w));
    bool inside = all(greaterThanEqual(place, vec2(0.0))) && all(lessThan(place, vec2(1.0)));
    bool reached = over_depth.z > 0.0 && inside && point.z <= farthest_m * SAME_DEPTH;
    float square_m = dot(point, point);
    float facing = abs(dot(normal, point)) / max(sqrt(dot(normal, normal) * square_m), 1e-30);
    // The eye may see the unlit side of a sheet. The vector from the eye to the point, divided by Z, is the vector from
    // the projector to the point minus the vector from the projector to the eye, which is the matrix's last column.
    vec3 seen_along = over_depth - projector_from_window[3].xyz * inverse_depth;
    bool same_side = dot(normal, point) * dot(normal, seen_along) > 0.0;
    // The sky is too far away to be lit.
    bool lit = reached && same_side && !is_sky;
    return ambient + (lit ? power * textureLod(pattern, place, 0.0).r * facing / square_m : 0.0);
}
