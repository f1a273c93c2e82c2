// The sky without the sun's disc: gradient, scattered sunlight, clouds and stars.
uniform vec4 zenith;     // w: share of the sky with clouds
uniform vec4 glow;       // colour of the light around the sun; w: brightness of the stars
uniform vec3 cloud_light;
in vec2 place;
layout(location = 0) out vec4 radiance;
layout(location = 1) out vec4 value;

float hash(vec2 place) {
    vec3 p = fract(vec3(place.xyx) * 0.1031);
    p += dot(p, p.yzx + 33.33);
    return fract((p.x + p.y) * p.z);
}

float value_noise(vec2 place) {
    vec2 cell = floor(place), part = place - cell;
    part = part * part * (3.0 - 2.0 * part);
    return mix(mix(hash(cell), hash(cell + vec2(1, 0)), part.x),
               mix(hash(cell + vec2(0, 1)), hash(cell + vec2(1, 1)), part.x), part.y);
}

float octaves(vec2 place, int count) {
    float sum = 0.0, weight = 0.5;
    for (int octave = 0; octave < count; octave++) {
        sum += weight * value_noise(place);
        place = mat2(1.6, 1.2, -1.2, 1.6) * place;
        weight *= 0.5;
    }
    return sum;
}

void main() {
    vec2 disc = (place - 0.5) / 0.49; // directions are the inverse of `sky` in common.glsl
    float square = min(dot(disc, disc), 1.0), up = (1.0 - square) / (1.0 + square);
    vec3 direction = vec3(disc / max(length(disc), 1.0) * (1.0 + up), -up);
    float toward = max(dot(direction, sun.xyz), 0.0);
    vec3 colour = mix(horizon.rgb, zenith.rgb, pow(up, 0.42));
    colour += glow.rgb * (0.10 * pow(toward, 3.0) + 0.25 * pow(toward, 24.0) + 1.2 * pow(toward, 400.0));
    float star = hash(floor(disc * 240.0));
    colour += glow.w * smoothstep(0.9965, 1.0, star) * up;
    if (zenith.w > 0.0) { // clouds on a plane, denser toward the horizon
        vec2 at = direction.xy / (up + 0.08) * 1.3 + horizon.w * vec2(0.004, 0.002);
        float dense = octaves(at, 5);
        float cover = smoothstep(0.78 - 0.62 * zenith.w, 1.02 - 0.62 * zenith.w, dense + 0.08);
        vec3 cloud = cloud_light * (1.05 - 0.45 * smoothstep(0.35, 0.95, dense)) + glow.rgb * 0.5 * pow(toward, 8.0);
        colour = mix(colour, mix(cloud, horizon.rgb, exp(-7.0 * up)), cover);
    }
    radiance = vec4(packed_light(colour), 1.0);
    float air = 1.0 - exp(-sky_light.w * 1000.0 / max(up, 0.05)); // fog is a layer
    value = vec4(image_value(mix(colour, horizon.rgb, air)), 1.0);
}
