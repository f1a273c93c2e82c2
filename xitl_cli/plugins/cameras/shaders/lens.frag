// From radiance to the values of an image: lens, vignetting, exposure, noise, response.
uniform sampler2D drawn;
uniform sampler2D source_of; // where in `drawn` each pixel looks, negative for outside of the lens's image
uniform bool ideal;
uniform float exposure, vignetting;
uniform vec2 noise;          // read, shot
uniform sampler2D grain;     // normal numbers
uniform ivec2 grain_at;      // of the first pixel of this image
uniform sampler2D curve;     // of sRGB
uniform vec2 picture_px;
in vec2 place;
out vec4 value;

void main() {
    vec2 from = ideal ? place : texture(source_of, place).xy;
    if (from.x < 0.0) discard; // another face has it, or the lens's image ends before it
    vec3 light = texture(drawn, from).rgb;
    vec2 off = (place - 0.5) * picture_px / length(picture_px) * 2.0;
    light *= exposure * (1.0 - vignetting * dot(off, off));
    light *= 0.6; // a film's curve, which rolls off towards saturation (Narkowicz 2015)
    vec3 response = light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14);
    if (noise != vec2(0.0)) {
        vec3 normal = texelFetch(grain, (ivec2(gl_FragCoord.xy) + grain_at) & 511, 0).rgb;
        response += normal * sqrt(noise.x * noise.x + noise.y * noise.y * response);
    }
    response = clamp(response, 0.0, 1.0) * (4095.0 / 4096.0) + 0.5 / 4096.0;
    value = vec4(texture(curve, vec2(response.r, 0.5)).r, texture(curve, vec2(response.g, 0.5)).r,
                 texture(curve, vec2(response.b, 0.5)).r, 1.0);
}
