// Shared by all shaders. Vectors are in NED, relative to the camera, unless a name says otherwise.
layout(std140) uniform Light {
    vec4 sun;          // direction to the sun; w: cosine of its radius
    vec4 sun_light;    // radiance of a white surface across the direct light
    vec4 sky_light;    // mean radiance of the sky; w: extinction of the air, 1/m
    vec4 ground_light; // radiance from below; w: exposure
    vec4 horizon;      // radiance of the air at the horizon; w: time, s
    vec4 water;        // diffuse reflectance of the water; w: variance of the slopes of waves that are not components
};

uniform sampler2D sky_map; // the upper half of all directions in a disc

const float PI = 3.14159265;

// Pictures hold sRGB of exposed light, in 8 bits: a film's curve, which rolls off towards saturation (Narkowicz 2015),
// then the response of sRGB by square roots.
vec3 image_value(vec3 radiance) {
    vec3 light = 0.6 * ground_light.w * radiance;
    vec3 x = clamp(light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14), 0.0, 1.0);
    vec3 root2 = sqrt(x), root4 = sqrt(root2), root8 = sqrt(root4);
    return 0.662002687 * root2 + 0.684122060 * root4 - 0.323583601 * root8 - 0.0225411470 * x;
}

// Radiance in textures of 8 bits, fine enough where the exposure is long
vec3 packed_light(vec3 radiance) {
    return sqrt(radiance * ground_light.w * 0.25);
}

vec3 unpacked_light(vec3 value) {
    return value * value * 4.0 / ground_light.w;
}

vec2 on_sky_map(vec3 direction) {
    return 0.5 + 0.49 * direction.xy / (1.0 + max(-direction.z, 0.0));
}

vec3 sky(vec3 direction) {
    return unpacked_light(textureLod(sky_map, on_sky_map(direction), 0.0).rgb);
}

vec3 through_air(vec3 radiance, float distance_m) {
    return mix(horizon.rgb, radiance, exp(-sky_light.w * distance_m));
}
