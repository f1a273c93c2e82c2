uniform sampler2D sky_values; // values of an image, as `sky_map` has radiance
in vec3 ray;
layout(location = 0) out vec4 value;
layout(location = 1) out uint number;

void main() {
    float scale = length(ray);
    vec3 shown = textureLod(sky_values, on_sky_map(ray, scale), 0.0).rgb;
    float disc = sun_light.w * smoothstep(-3e-6, 3e-6, dot(ray, sun.xyz) - sun.w * scale);
    value = vec4(mix(shown, vec3(1.0), disc), 1.0);
    number = 65000u;
}
