uniform vec3 foam_frame;
in vec2 in_place;   // relative to the camera
in float in_share;
out float share;

void main() {
    share = in_share;
    gl_Position = vec4((in_place - foam_frame.xy) / foam_frame.z * 2.0 - 1.0, 0.0, 1.0);
}
