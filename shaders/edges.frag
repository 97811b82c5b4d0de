#version 450 core
// Blends the colour on the other side of an edge into a pixel, by the share of the pixel on that side. A pixel whose
// centre is outside the surface gets the colour of the surface's patch, lit by the projector if LIT. A pixel whose
// centre is inside gets the next pixel's colour.

in vec4 seen_patch;  // coordinate of the point of the edge beside this pixel, layer, level
flat in vec4 line;   // the edge's unit normal, away from the surface, and its offset, px; 1 for a large patch, else 0

layout(binding = 0) uniform sampler2DArray atlas;
#ifdef LARGE
layout(binding = 1) uniform sampler2DArray large_atlas;
#endif
layout(binding = 4) uniform sampler2D drawn;

#ifdef LIT
#include "common_projector.glsl"

flat in vec3 normal;  // of the surface, in the projector's frame
#endif

layout(location = 0) out vec4 colour;

void main() {
    // The share of a pixel that lies beyond a line at this distance from the pixel's centre.
    float signed_px = dot(line.xy, gl_FragCoord.xy) + line.z;
    vec2 extent = abs(line.xy);
    float longer = max(extent.x, extent.y), shorter = min(extent.x, extent.y);
    float rest = max(0.5 * (longer + shorter) - abs(signed_px), 0.0);
    float share = rest > shorter ? 0.5 - abs(signed_px) / longer : rest * rest / (2.0 * longer * max(shorter, 1e-6));
    if (signed_px < 0.0) {
        // The centre of the next pixel certainly lies beyond the edge.
        ivec2 across = extent.x > extent.y ? ivec2(sign(line.x), 0) : ivec2(0, sign(line.y));
        ivec2 next = clamp(ivec2(gl_FragCoord.xy) + across, ivec2(0), textureSize(drawn, 0) - 1);
        colour = vec4(texelFetch(drawn, next, 0).rgb, share);
        return;
#ifdef LARGE
    } else if (line.w > 0.5) {
        colour = vec4(textureLod(large_atlas, seen_patch.xyz, round(seen_patch.w)).rgb, share);
#endif
    } else {
        colour = vec4(textureLod(atlas, seen_patch.xyz, round(seen_patch.w)).rgb, share);
    }
#ifdef LIT
    // Beyond the edge, the strip has the depth of the edge.
    vec2 on_edge_px = gl_FragCoord.xy - signed_px * line.xy;
    colour.rgb *= light_on(over_depth_at(on_edge_px, gl_FragCoord.w), gl_FragCoord.w, normal, false);
#endif
}
