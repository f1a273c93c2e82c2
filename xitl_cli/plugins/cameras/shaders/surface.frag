// The shape of the water, for its light: metres along the optical axis, and slopes in steps of 1/4096.
in vec2 slope;
in float depth_m;
out uvec2 surface;

void main() {
    uvec2 steps = uvec2(clamp(slope * 4096.0 + 32768.5, 0.0, 65535.0));
    surface = uvec2(floatBitsToUint(depth_m), steps.x | (steps.y << 16));
}
