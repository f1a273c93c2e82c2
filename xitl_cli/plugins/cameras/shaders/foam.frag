in float share;
out vec4 foam;

void main() {
    foam = vec4(share);
}
