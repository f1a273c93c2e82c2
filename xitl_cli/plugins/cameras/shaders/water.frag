// Fresnel reflection of sky and objects, glitter of the sun (Cox and Munk 1954), light from the water, foam.
uniform sampler2D ripples;    // slope north and east of the waves that are not components, unit variance; foam noise
uniform sampler2D mirrored;   // objects, mirrored at the still surface
uniform sampler2D foam_map;   // share of foam around the camera
uniform vec3 foam_frame;      // corner relative to the camera, and size of the map
uniform vec2 picture_px;
uniform vec4 wind;            // direction of the wind as a unit vector, its speed, share of whitecaps
in vec3 position;
in vec2 slope, on_map;
in float rise;
out vec4 radiance;

void main() {
    float distance_m = length(position);
    vec3 view = position / distance_m;
    float time = horizon.w;
    vec2 drift = wind.xy * time;
    vec4 fine = texture(ripples, on_map / 1.9 - 0.21 * drift / 1.9);
    vec4 coarse = texture(ripples, on_map.yx / 7.6 - 0.34 * drift.yx / 7.6);
    float small = sqrt(0.5 * water.w);
    vec2 more = small * (0.75 * fine.xy + 0.65 * coarse.yx);
    // What the texture no longer resolves, far away, makes the reflection rough.
    float resolved = clamp(18.0 / distance_m, 0.0, 1.0);
    vec2 total = slope + more * resolved;
    float rough = 0.0008 + water.w * (1.0 - 0.9 * resolved);
    vec3 n = normalize(vec3(total, -1.0));
    float facing = max(-dot(n, view), 0.02);
    // A grazing view sees the slopes toward the camera only.
    float grazing = 1.0 - facing, grazing2 = grazing * grazing;
    float fresnel = 0.02 + 0.98 * grazing2 * grazing2 * grazing / (1.0 + 18.0 * sqrt(rough));
    vec3 bounced = reflect(view, n);
    bounced.z = min(bounced.z, -0.02 - 0.6 * sqrt(rough));
    bounced = normalize(bounced);
    vec3 reflected = sky(bounced);
    vec2 place = gl_FragCoord.xy / picture_px;
    place += vec2(dot(total, vec2(-view.y, view.x)), dot(total, view.xy)) * vec2(0.12, -0.35) * clamp(6.0 / distance_m, 0.05, 1.0);
    vec4 object = texture(mirrored, clamp(place, 0.001, 0.999));
    reflected = mix(reflected, object.rgb, object.a);
    vec3 half_way = normalize(sun.xyz - view);
    vec2 facet = half_way.xy / -half_way.z + total;
    float half2 = half_way.z * half_way.z;
    float chance = exp(-dot(facet, facet) / rough) / (PI * rough * half2 * half2);
    float away = 1.0 - max(dot(half_way, -view), 0.0), away2 = away * away;
    float mirror = 0.02 + 0.98 * away2 * away2 * away;
    vec3 glitter = sun_light.rgb * PI * mirror * min(chance, 4e3) / (4.0 * facing) * (1.0 - object.a) * step(half_way.z, 0.0);
    vec3 light = sky_light.rgb + sun_light.rgb * max(-sun.z, 0.0);
    vec3 body = water.rgb * light * (1.0 + 0.8 * clamp(rise, -0.5, 0.5));
    vec3 colour = mix(body, reflected, fresnel) + glitter;
    // Foam: behind vessels, and whitecaps at crests
    vec2 on_foam = (position.xy - foam_frame.xy) / foam_frame.z;
    float trail = all(lessThan(abs(on_foam - 0.5), vec2(0.5))) ? texture(foam_map, on_foam).r : 0.0;
    float crest = fine.b * 0.5 + coarse.b * 0.5 + 0.15 * clamp(rise / (0.1 + 0.02 * wind.z), -1.0, 1.0);
    float foam = trail * smoothstep(0.25, 0.75, fine.b + 0.6 * trail)
        + smoothstep(1.0 - 3.0 * wind.w, 1.0 - 1.5 * wind.w, crest) * step(1e-4, wind.w);
    colour = mix(colour, 0.75 * light, clamp(foam, 0.0, 0.9));
    radiance = vec4(through_air(colour, distance_m), 1.0);
}
