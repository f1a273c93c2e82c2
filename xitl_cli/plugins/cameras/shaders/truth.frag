// Number of the object, metres along the optical axis, temperature.
flat in float id;
in float temperature, depth_m;
out vec4 measured;

void main() {
    measured = vec4(id, depth_m, temperature, 1.0);
}
