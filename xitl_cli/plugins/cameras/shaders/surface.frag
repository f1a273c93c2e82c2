// The shape of the water, for its light: metres along the optical axis, and slope.
in vec2 slope;
in float depth_m;
out vec4 surface;

void main() {
    surface = vec4(depth_m, slope, 1.0);
}
