// Fresnel reflection of sky and objects, glitter of the sun, light from the water, foam.
uniform usampler2D surface;   // of surface.frag
uniform sampler2D ripples;    // (4 + slope north, slope east) / 8 of the waves that are not components, unit variance; noise
uniform sampler2D mirrored;   // objects, mirrored at the still surface
uniform sampler2D foam_map;   // share of foam around the camera
uniform sampler2D shade_map;  // share of shadow around the camera
uniform vec3 foam_frame;      // corner relative to the camera, and size of the map of foam
uniform vec3 shade_frame;
in vec2 place;
in vec3 ray;
flat in vec3 shaded;          // light without the sun, of the light of the sea
flat in vec3 sea;             // position of the camera in the pattern of ripples, its height above the still surface
layout(location = 0) out vec4 value;
layout(location = 1) out uint number;

void main() {
    uvec2 shape = texelFetch(surface, ivec2(gl_FragCoord.xy), 0).xy;
    vec2 slope = vec2(shape.y & 65535u, shape.y >> 16) * (1.0 / 4096.0) - 8.0;
    vec3 position = ray * uintBitsToFloat(shape.x);
    float distance_m = length(position), rise = sea.z - position.z;
    vec3 view = position / distance_m;
    // What the pattern of ripples no longer shows, far away, makes the reflection rough.
    float resolved = min(18.0 / distance_m, 1.0);
    float rough = 0.0008 + water.w * (1.0 - 0.9 * resolved), root = sqrt(rough);
    vec3 fine = texture(ripples, (position.xy + sea.xy) * (1.0 / TILE_M)).rgb;
    vec2 total = slope + foam_light.w * resolved * (8.0 * fine.xy - 4.0);
    vec3 n = vec3(total, -1.0) * (1.0 - 0.5 * dot(total, total)); // a unit vector, to the second order
    float across = dot(n, view);
    vec3 bounced = view - 2.0 * across * n;
    vec3 reflected = sky(vec3(bounced.xy, min(bounced.z, -0.02 - 0.6 * root)));
    vec2 shift = vec2(total.y * view.x - total.x * view.y, dot(total, view.xy));
    vec4 object = texture(mirrored, place + shift * vec2(0.12, -0.35) * max(resolved * 0.33, 0.05));
    reflected = mix(reflected, unpacked_light(object.rgb), object.a);
    // Cox and Munk 1954: the radiance of the sun's glitter from the chance of the slope that reflects the sun
    vec3 half_way = normalize(sun.xyz - view);
    float cosine = min(half_way.z, -0.05), cosine2 = cosine * cosine;
    float spread = 4.0 * max(view.z, 0.02) * rough * cosine2 * cosine2;
    float damping = 1.0 + 18.0 * root;                  // of Fresnel's reflection, by roughness
    float inverse = 1.0 / (spread * damping * rough * cosine);
    vec2 off = total - half_way.xy * (inverse * spread * damping * rough);
    float away = 1.0 - max(dot(half_way, -view), 0.0), away2 = away * away;
    float mirror = 0.02 + 0.98 * away2 * away2 * away;
    float glitter = half_way.z < 0.0 ? mirror * inverse * damping * rough * cosine : 0.0;
    glitter *= (1.0 - object.a) * exp(-dot(off, off) * inverse * spread * damping * cosine);
    float grazing = clamp(1.0 + across, 0.0, 0.98), grazing2 = grazing * grazing;
    float fresnel = 0.02 + 0.98 * grazing2 * grazing2 * grazing * (inverse * spread * rough * cosine);
    vec3 from_water = water.rgb * (1.0 + 0.8 * clamp(rise, -0.5, 0.5)), of_foam = foam_light.rgb;
#ifdef NEAR
    vec2 still = position.xy + rise * sun.xy / sun.z; // the map has shadows on the still surface, along the sun
    float shade = texture(shade_map, (still - shade_frame.xy) / shade_frame.z).r;
    vec3 light = mix(vec3(1.0), shaded, shade);
    from_water *= light;
    of_foam *= light;
    glitter *= 1.0 - shade;
#endif
    vec3 colour = mix(from_water, reflected, fresnel) + glitter * sun_light.rgb;
    // Foam: whitecaps at crests, and behind vessels
    float crest = fine.b + 0.15 * clamp(rise * whitecaps.x, -1.0, 1.0);
    float share = clamp((crest - whitecaps.y) * whitecaps.z, 0.0, 1.0);
    share *= share * (3.0 - 2.0 * share);
#ifdef NEAR
    float trail = texture(foam_map, (position.xy - foam_frame.xy) / foam_frame.z).r;
    share += trail * smoothstep(0.25, 0.75, fine.b + 0.6 * trail);
#endif
    colour = mix(colour, of_foam, min(share, 0.9));
    number = 60000u;
    value = vec4(image_value(through_air(colour, distance_m)), 1.0);
}
