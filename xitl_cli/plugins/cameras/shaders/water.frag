// Fresnel reflection of sky and objects, glitter of the sun, light from the water, foam.
uniform sampler2D surface;    // metres along the optical axis, slope north, slope east
uniform sampler2D ripples;    // (4 + slope north, slope east) / 8 of the waves that are not components, unit variance; noise
uniform sampler2D mirrored;   // objects, mirrored at the still surface
uniform sampler2D foam_map;   // share of foam around the camera
uniform vec3 water_at;        // still surface below the camera, relative to it
uniform vec2 origin_ne;       // position of the camera modulo the tile of the ripples
uniform vec3 foam_frame;      // corner relative to the camera, and size of the map of foam
uniform vec4 wind;            // direction of the wind as a unit vector, its speed, share of whitecaps
in vec2 place;
in vec3 ray;
uniform float water_id;
layout(location = 0) out vec4 value;
layout(location = 1) out float number;

void main() {
    vec3 shape = texelFetch(surface, ivec2(gl_FragCoord.xy), 0).xyz;
    vec3 position = ray * shape.x;
    float distance_m = length(position), rise = water_at.z - position.z;
    vec3 view = position / distance_m;
    // What the pattern of ripples no longer shows, far away, makes the reflection rough.
    float resolved = clamp(18.0 / distance_m, 0.0, 1.0);
    float rough = 0.0008 + water.w * (1.0 - 0.9 * resolved);
    vec2 drift = wind.xy * horizon.w;
    vec3 fine = texture(ripples, (position.xy + origin_ne - 0.25 * drift) * (1.0 / TILE_M)).rgb;
    vec2 total = shape.yz + sqrt(0.5 * water.w) * resolved * (8.0 * fine.xy - 4.0);
    vec3 n = vec3(total, -1.0) * (1.0 - 0.5 * dot(total, total)); // a unit vector, to the second order
    float across = dot(n, view);
    float grazing = clamp(1.0 + across, 0.0, 0.98), grazing2 = grazing * grazing;
    float steepest = -0.02 - 0.6 * sqrt(rough);
    float fresnel = 0.02 + 0.98 * grazing2 * grazing2 * grazing / (1.0 - 30.0 * (steepest + 0.02));
    vec3 bounced = view - 2.0 * across * n;
    vec3 reflected = sky(vec3(bounced.xy, min(bounced.z, steepest)));
    vec2 shift = vec2(total.y * view.x - total.x * view.y, dot(total, view.xy));
    vec4 object = texture(mirrored, place + shift * vec2(0.12, -0.35) * max(resolved * 0.33, 0.05));
    reflected = mix(reflected, unpacked_light(object.rgb), object.a);
    vec3 light = sky_light.rgb + sun_light.rgb * max(-sun.z, 0.0);
    vec3 colour = mix(water.rgb * light * (1.0 + 0.8 * clamp(rise, -0.5, 0.5)), reflected, fresnel);
    // Cox and Munk 1954: the radiance of the sun's glitter from the chance of the slope that reflects the sun
    vec3 half_way = normalize(sun.xyz - view);
    float cosine = min(half_way.z, -0.05), cosine2 = cosine * cosine;
    vec2 off = half_way.xy / -cosine + total;
    float away = 1.0 - max(dot(half_way, -view), 0.0), away2 = away * away;
    float mirror = 0.02 + 0.98 * away2 * away2 * away;
    float facing = max(view.z, 0.02);
    float glitter = mirror * step(half_way.z, 0.0) / (4.0 * facing * rough * cosine2 * cosine2);
    colour += sun_light.rgb * glitter * (1.0 - object.a) * exp(-dot(off, off) / rough);
    // Foam: behind vessels, and whitecaps at crests
    float trail = texture(foam_map, (position.xy - foam_frame.xy) / foam_frame.z).r;
    float foam = trail * smoothstep(0.25, 0.75, fine.b + 0.6 * trail);
    if (wind.w > 1e-4) {
        float crest = fine.b + 0.15 * clamp(rise / (0.1 + 0.02 * wind.z), -1.0, 1.0);
        foam += smoothstep(1.0 - 3.0 * wind.w, 1.0 - 1.5 * wind.w, crest);
    }
    colour = mix(colour, 0.75 * light, min(foam, 0.9));
    number = water_id;
    value = vec4(image_value(through_air(colour, distance_m)), 1.0);
}
