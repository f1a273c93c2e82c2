// One triangle that covers the picture, as far away as possible.
uniform mat3 rot_ned_view;
uniform vec2 tangent; // of half the field of view
out vec2 place;       // 0 to 1
out vec3 ray;         // from the camera to a depth of 1

void main() {
    place = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
    ray = rot_ned_view * vec3((place * 2.0 - 1.0) * tangent, 1.0);
    gl_Position = vec4(place * 2.0 - 1.0, 1.0, 1.0);
}
