uniform sampler2D sky_values; // values of an image, as `sky_map` has radiance
in vec3 ray;
layout(location = 0) out vec4 value;
layout(location = 1) out float number;

void main() {
    vec3 direction = normalize(ray);
    vec3 shown = textureLod(sky_values, on_sky_map(direction), 0.0).rgb;
    float disc = smoothstep(sun.w - 3e-6, sun.w + 3e-6, dot(direction, sun.xyz)) * step(1e-3, sun_light.r);
    value = vec4(mix(shown, vec3(1.0), disc * exp(-400.0 * sky_light.w)), 1.0);
    number = 65000.0;
}
