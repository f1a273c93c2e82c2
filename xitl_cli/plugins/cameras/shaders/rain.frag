// A drop shows nearly all directions at once, so mostly the sky (Garg and Nayar 2007).
in vec4 streak;
layout(location = 0) out vec4 value;

void main() {
    float beyond = max(abs(streak.y) - streak.z, 0.0);
    float fade = max(1.0 - length(vec2(streak.x, beyond)), 0.0);
    value = vec4(image_value(0.9 * sky_light.rgb), streak.w * fade);
}
