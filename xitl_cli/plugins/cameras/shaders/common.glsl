// Shared by all shaders. Vectors are in NED, relative to the camera, unless a name says otherwise.
#ifdef SCREEN
flat in vec4 flat_rows[8]; // Mesa's software renderer reads a flat value much faster than a uniform
#define LIGHT flat_rows
#else
layout(std140) uniform Light { vec4 light_rows[8]; };
#define LIGHT light_rows
#endif
#define sun LIGHT[0]          // direction to the sun; w: cosine of its radius
#define sun_light LIGHT[1]    // radiance of a white surface across the direct light; w: opacity of the sun's disc
#define sky_light LIGHT[2]    // mean radiance of the sky; w: extinction of the air, 1/m
#define ground_light LIGHT[3] // radiance from below; w: exposure
#define horizon LIGHT[4]      // radiance of the air at the horizon; w: time of the clouds, s
#define water LIGHT[5]        // radiance from the water; w: variance of the slopes of waves that are not components
#define foam_light LIGHT[6]   // radiance of foam; w: deviation of a slope of the ripples
#define whitecaps LIGHT[7]    // 1 / height of a crest, least pattern with foam, 1 / range of the pattern; w: 4 / exposure

uniform sampler2D sky_map; // the upper half of all directions in a disc

const float PI = 3.14159265;

// Pictures hold sRGB of exposed light, in 8 bits: a film's curve, which rolls off towards saturation (Narkowicz 2015),
// then the response of sRGB. This ratio of polynomials is within 0.3 / 255 of both.
vec3 image_value(vec3 radiance) {
    vec3 light = min(ground_light.w * radiance, 100.0);
    vec3 above = light * (light * (light * 290.52089 + 112.11988) + 4.39271) - 0.02277;
    vec3 below = light * (light * (light * 286.56276 + 157.84079) + 39.32637) + 1.0;
    return above / below;
}

// Radiance in textures of 8 bits, fine enough where the exposure is long
vec3 packed_light(vec3 radiance) {
    return sqrt(radiance * ground_light.w * 0.25);
}

vec3 unpacked_light(vec3 value) {
    return value * value * whitecaps.w;
}

vec2 on_sky_map(vec3 ray, float scale) { // scale: length of the ray
    return 0.5 + 0.49 * ray.xy / (scale + max(-ray.z, 0.0));
}

vec3 sky(vec3 direction) {
    return unpacked_light(textureLod(sky_map, on_sky_map(direction, 1.0), 0.0).rgb);
}

vec3 through_air(vec3 radiance, float distance_m) {
    return mix(horizon.rgb, radiance, exp(-sky_light.w * distance_m));
}
