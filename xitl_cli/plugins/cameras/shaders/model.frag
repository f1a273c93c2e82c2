uniform sampler2DShadow shadow_map;
uniform sampler2D ripples;    // the third value is noise
uniform mat4 to_shadow;
in vec3 position, normal, in_model, normal_in_model;
in vec4 colour;
flat in float id;
layout(location = 0) out vec4 value;
layout(location = 1) out uint number;

float lit(vec3 at) {
    vec4 place = to_shadow * vec4(at, 1.0);
    if (any(greaterThan(abs(place.xy), vec2(1.0))) || place.z > 1.0) return 1.0;
    return texture(shadow_map, vec3(place.xy * 0.5 + 0.5, place.z * 0.5 + 0.498));
}

void main() {
    float distance_m = length(position);
    vec3 n = normalize(normal), view = position / distance_m;
    if (dot(n, view) > 0.0) n = -n;
    // A pattern on the surface, in the axes of the model, that fades where a pixel covers it
    vec3 side = abs(normal_in_model);
    vec2 on = side.z > max(side.x, side.y) ? in_model.xy : (side.x > side.y ? in_model.yz : in_model.xz);
    float fade = clamp(30.0 / distance_m, 0.0, 1.0);
    float pattern = 1.6 * (texture(ripples, on * 0.16).b - 0.5) * mix(0.45, 1.0, fade);
    vec3 reflectance = colour.rgb * (1.0 + max(colour.w, 0.0) * pattern);
    float facing = max(dot(n, sun.xyz), 0.0);
    float bright = facing > 0.0 ? lit(position + 0.04 * n) : 0.0;
    vec3 around = mix(ground_light.rgb, sky_light.rgb, 0.5 - 0.5 * n.z);
    vec3 light = around + sun_light.rgb * facing * bright;
    vec3 half_way = normalize(sun.xyz - view);
    float gloss2 = max(dot(n, half_way), 0.0), gloss4, gloss8, gloss16;
    gloss2 *= gloss2, gloss4 = gloss2 * gloss2, gloss8 = gloss4 * gloss4, gloss16 = gloss8 * gloss8;
    float gloss = (1.0 - colour.w) * 0.25 * gloss16 * gloss16 * gloss16 * gloss8 * gloss4 * bright;
    // A light is on while the sun is down.
    vec3 shining = colour.w < 0.0 ? colour.rgb * (1.0 - smoothstep(-0.02, 0.02, -sun.z)) : vec3(0.0);
    vec3 radiance = through_air(reflectance * light + gloss * sun_light.rgb + shining, distance_m);
#ifdef MIRRORED
    value = vec4(packed_light(radiance), 1.0);
#else
    value = vec4(image_value(radiance), 1.0);
    number = uint(id);
#endif
}
