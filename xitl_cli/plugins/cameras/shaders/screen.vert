// One triangle that covers the picture.
out vec2 place; // 0 to 1

void main() {
    place = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
    gl_Position = vec4(place * 2.0 - 1.0, 1.0, 1.0);
}
