// The blended colours; black where the recording shows nothing.
uniform highp sampler2D blended;
uniform highp sampler2D fieldOfView;
uniform bool isRecorded;
uniform vec2 size;
out vec4 colour;

void main() {
  vec2 share = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y) / size;
  bool isInside = !isRecorded || texture(fieldOfView, share).r > 0.5;
  colour = vec4(isInside ? texelFetch(blended, ivec2(gl_FragCoord.xy), 0).rgb : vec3(0.0), 1.0);
}
