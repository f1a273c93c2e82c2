// Fresnel reflection of sky and objects, glitter of the sun, light from the water, foam.
uniform sampler2D ripples;    // (4 + slope north, slope east) / 8 of the waves that are not components, unit variance; noise
uniform sampler2D mirrored;   // objects, mirrored at the still surface
uniform sampler2D foam_map;   // share of foam around the camera
uniform vec2 per_px;          // size of a pixel, the picture is 1 by 1
uniform vec4 wind;            // direction of the wind as a unit vector, its speed, share of whitecaps
in vec3 view;
in vec2 slope, on_map, on_foam;
in vec4 far;
in vec3 glitter;
in vec2 facet;
in float rise;
flat in float id;
layout(location = 0) out vec4 value;
layout(location = 1) out float number;

void main() {
    vec2 drift = wind.xy * horizon.w;
    vec3 fine = texture(ripples, (on_map - 0.25 * drift) * (1.0 / TILE_M)).rgb;
    vec2 total = slope + sqrt(0.5 * water.w) * far.y * (8.0 * fine.xy - 4.0);
    vec3 n = vec3(total, -1.0) * (1.0 - 0.5 * dot(total, total)); // a unit vector, to the second order
    float across = dot(n, view);
    float grazing = clamp(1.0 + across, 0.0, 0.98), grazing2 = grazing * grazing;
    float fresnel = 0.02 + 0.98 * grazing2 * grazing2 * grazing / (1.0 - 30.0 * (far.w + 0.02));
    vec3 bounced = view - 2.0 * across * n;
    vec3 reflected = sky(vec3(bounced.xy, min(bounced.z, far.w)));
    vec2 place = gl_FragCoord.xy * per_px;
    vec2 shift = vec2(total.y * view.x - total.x * view.y, dot(total, view.xy));
    vec4 object = texture(mirrored, place + shift * vec2(0.12, -0.35) * max(far.y * 0.33, 0.05));
    reflected = mix(reflected, unpacked_light(object.rgb), object.a);
    vec3 light = sky_light.rgb + sun_light.rgb * max(-sun.z, 0.0);
    vec3 colour = mix(water.rgb * light * (1.0 + 0.8 * clamp(rise, -0.5, 0.5)), reflected, fresnel);
    vec2 off = facet + total;
    colour += glitter * (1.0 - object.a) * exp(-dot(off, off) / far.z);
    // Foam: behind vessels, and whitecaps at crests
    float trail = texture(foam_map, on_foam).r;
    float foam = trail * smoothstep(0.25, 0.75, fine.b + 0.6 * trail);
    if (wind.w > 1e-4) {
        float crest = fine.b + 0.15 * clamp(rise / (0.1 + 0.02 * wind.z), -1.0, 1.0);
        foam += smoothstep(1.0 - 3.0 * wind.w, 1.0 - 1.5 * wind.w, crest);
    }
    colour = mix(colour, 0.75 * light, min(foam, 0.9));
    value = vec4(image_value(mix(horizon.rgb, colour, far.x)), 1.0);
    number = id;
}
