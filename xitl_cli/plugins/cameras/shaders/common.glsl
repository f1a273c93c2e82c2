// Shared by all shaders. Vectors are in NED, relative to the camera, unless a name says otherwise.
layout(std140) uniform Light {
    vec4 sun;          // direction to the sun; w: cosine of its radius
    vec4 sun_light;    // radiance of direct light on a surface across it; w: radiance of the disc over that
    vec4 sky_light;    // mean radiance of the sky; w: extinction of the air, 1/m
    vec4 ground_light; // radiance from below; w: radius of the earth, for the horizon
    vec4 horizon;      // radiance of the air at the horizon; w: time, s
    vec4 water;        // diffuse reflectance of the water; w: variance of the slopes of waves that are not components
};

uniform sampler2D sky_map; // the upper half of all directions in a disc

const float PI = 3.14159265;

vec3 sky(vec3 direction) {
    return textureLod(sky_map, 0.5 + 0.49 * direction.xy / (1.0 + max(-direction.z, 0.0)), 0.0).rgb;
}

vec3 sun_disc(vec3 direction) {
    float inside = smoothstep(sun.w - 3e-6, sun.w + 3e-6, dot(direction, sun.xyz));
    return inside * sun_light.rgb * sun_light.w;
}

vec3 through_air(vec3 radiance, float distance_m) {
    return mix(horizon.rgb, radiance, exp(-sky_light.w * distance_m));
}
