// Projects a Gaussian onto the image plane: the rules of crates/core/src/raster/project.rs.
uniform highp usampler2D order;
uniform highp sampler2D gaussians;
uniform highp sampler2D shares;
uniform bool showsShares;
uniform mat3 rotation;
uniform vec3 translation;
uniform vec4 lens;
uniform vec4 guard;
uniform vec2 size;
out vec2 corner;
flat out float cut;
flat out vec4 colour;

const int ROW = TEXELS / 4;

mat3 turned(vec4 q) {
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec4 texel(ivec2 place, int k) {
  return texelFetch(gaussians, ivec2(4 * place.x + k, place.y), 0);
}

void main() {
  // Four vertices for each Gaussian, in the order of drawing.
  int drawn = gl_VertexID / 4;
  int number = int(texelFetch(order, ivec2(drawn % TEXELS, drawn / TEXELS), 0).r);
  ivec2 place = ivec2(number % ROW, number / ROW);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  vec4 centre = texel(place, 0);
  float opacity = centre.w;
  vec3 point = rotation * centre.xyz + translation;
  if (!(point.z > NEAR) || !(opacity >= MIN_ALPHA)) return;
  vec3 scale = texel(place, 2).xyz;
  mat3 axes = rotation * turned(texel(place, 1));
  axes = mat3(axes[0] * scale.x, axes[1] * scale.y, axes[2] * scale.z);
  vec2 slope = clamp(point.xy / point.z, guard.xy, guard.zw);
  vec3 x = vec3(axes[0].x, axes[1].x, axes[2].x);
  vec3 y = vec3(axes[0].y, axes[1].y, axes[2].y);
  vec3 z = vec3(axes[0].z, axes[1].z, axes[2].z);
  vec3 u = lens.x / point.z * (x - slope.x * z);
  vec3 v = lens.y / point.z * (y - slope.y * z);
  float xx = dot(u, u) + DILATION, xy = dot(u, v), yy = dot(v, v) + DILATION;
  vec3 across = cross(u, v);
  float determinant = dot(across, across) + DILATION * (dot(u, u) + dot(v, v)) + DILATION * DILATION;
  if (!(determinant > 0.0) || isinf(determinant)) return;
  // Variances along the ellipse's own axes.
  float swing = length(vec2(0.5 * (xx - yy), xy));
  float longest = 0.5 * (xx + yy) + swing;
  float angle = swing > 0.0 ? 0.5 * atan(xy, 0.5 * (xx - yy)) : 0.0;
  vec2 along = vec2(cos(angle), sin(angle));
  // Alpha is at least MIN_ALPHA within the ellipse of this squared radius.
  cut = 2.0 * log(opacity / MIN_ALPHA);
  corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
  vec2 half_axes = corner * sqrt(cut * vec2(longest, determinant / longest));
  vec2 pixel = lens.xy * point.xy / point.z + lens.zw + half_axes.x * along + half_axes.y * vec2(-along.y, along.x);
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
  vec3 shown = showsShares ? texelFetch(shares, place, 0).rgb : texel(place, 3).rgb;
  colour = vec4(shown, opacity);
}
