uniform mat3 rot_ned_view;
uniform vec2 tangent; // of half the field of view
in vec2 place;
out vec4 radiance;

void main() {
    vec3 direction = rot_ned_view * normalize(vec3((place * 2.0 - 1.0) * tangent, 1.0));
    vec3 colour = sky(direction) + sun_disc(direction);
    float air = 1.0 - exp(-sky_light.w * 8000.0 / max(-direction.z * 8.0, 0.4)); // fog is a layer
    radiance = vec4(mix(colour, horizon.rgb, clamp(air, 0.0, 1.0)), 0.0);
}
