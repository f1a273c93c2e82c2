// From a picture to the values of an image: lens, vignetting, noise.
uniform sampler2D drawn;
uniform sampler2D source_of; // where in `drawn` each pixel looks, negative for outside of the lens's image
uniform bool ideal, summed;
uniform float vignetting;
uniform vec2 noise;          // read, shot
uniform sampler2D grain;     // 0.5 + a sixth of normal numbers
uniform ivec2 grain_at;      // of the first pixel of this image
uniform vec2 picture_px;
in vec2 place;
out vec4 value;

void main() {
    vec2 from = ideal ? place : texture(source_of, place).xy;
    if (from.x < 0.0) discard; // another face has it, or the lens's image ends before it
    vec3 shown = texture(drawn, from).rgb;
    if (summed) shown = sqrt(shown);
    if (vignetting > 0.0) {
        vec2 off = (place - 0.5) * picture_px / length(picture_px) * 2.0;
        shown *= sqrt(1.0 - vignetting * dot(off, off));
    }
    if (noise != vec2(0.0)) {
        vec3 normal = 6.0 * texelFetch(grain, (ivec2(gl_FragCoord.xy) + grain_at) & 511, 0).rgb - 3.0;
        shown += normal * sqrt(noise.x * noise.x + noise.y * noise.y * shown);
    }
    value = vec4(shown, 1.0);
}
