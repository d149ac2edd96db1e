// Precomputed radiance transfer: what a shader does with transfer that torchprt baked. HLSL, shader model 5 on.
//
// Numbers are those of torchprt, nothing is converted:
// - SH basis real, orthonormal, with the Condon-Shortley sign, index l(l + 1) + m: y_00 = .282095, y_1-1 = -.488603 y,
//   y_10 = .488603 z, y_11 = -.488603 x. The world is right-handed; whatever axis is up. In a left-handed engine mirror
//   one axis of mesh and light alike: mirrored in z, coefficients with odd l + m change sign.
// - Light: coefficients of linear RGB radiance that arrives from s, turned into the frame that the transfer was baked in.
//   A light of radiance 1 from everywhere is (3.544908, 0, 0, ...).
// - Transfer has 1/pi and shadows in it. What comes out times the albedo is linear exit radiance: expose it, tone map it
//   and encode it as sRGB yourself. A black corner may come out a little below 0: clamp it there.
// PRT_ORDER is the number of bands, 1 to 8 or so; define it before this text.
#ifndef PRT_ORDER
#define PRT_ORDER 3
#endif
#define PRT_COUNT (PRT_ORDER * PRT_ORDER)

// The basis at a unit direction.
void prtBasis(float3 s, out float y[PRT_COUNT]) {
  float sectoral = 0.28209479177387814;
  float real = 1.0;
  float imaginary = 0.0;
  [unroll] for (int m = 0; m < PRT_ORDER; m++) {
    if (m > 0) {
      // (x + iy)^m.
      float before = real;
      real = before * s.x - imaginary * s.y;
      imaginary = before * s.y + imaginary * s.x;
      sectoral *= -sqrt(float(2 * m + 1) / float(2 * m));
    }
    float scale = m > 0 ? 1.4142135623730951 : 1.0;
    float below = 0.0;
    float here = sectoral;
    [unroll] for (int l = m; l < PRT_ORDER; l++) {
      if (l > m) {
        float a = sqrt(float(4 * l * l - 1) / float(l * l - m * m));
        float b = sqrt(float((l - 1) * (l - 1) - m * m) / float(4 * (l - 1) * (l - 1) - 1));
        float above = a * (s.z * here - b * below);
        below = here;
        here = above;
      }
      y[l * (l + 1) + m] = scale * here * real;
      if (m > 0) y[l * (l + 1) - m] = scale * here * imaginary;
    }
  }
}

// Radiance over albedo of a diffuse receiver: its transfer vector times the light. One channel for all colours.
float3 prtDiffuse(float transfer[PRT_COUNT], float3 light[PRT_COUNT]) {
  float3 sum = float3(0.0, 0.0, 0.0);
  [unroll] for (int i = 0; i < PRT_COUNT; i++) sum += transfer[i] * light[i];
  return sum;
}

// The same where light bounced off coloured surfaces: three channels.
float3 prtDiffuseColour(float3 transfer[PRT_COUNT], float3 light[PRT_COUNT]) {
  float3 sum = float3(0.0, 0.0, 0.0);
  [unroll] for (int i = 0; i < PRT_COUNT; i++) sum += transfer[i] * light[i];
  return sum;
}

// One zonal lobe: the light that it gathers about `axis`, a unit vector in the frame of the light. `bands`: g*_l of a
// colour each, SH coefficients over y_lm(axis). Where bands 0 and 1 are stored apart, their entries are 0 here.
// A surface that deformation turns by R has the axes R a, and the same bands.
float3 prtLobe(float3 axis, float3 bands[PRT_ORDER], float3 light[PRT_COUNT]) {
  float y[PRT_COUNT];
  prtBasis(axis, y);
  float3 sum = float3(0.0, 0.0, 0.0);
  [unroll] for (int l = 0; l < PRT_ORDER; l++) {
    float3 band = float3(0.0, 0.0, 0.0);
    [unroll] for (int i = l * l; i < (l + 1) * (l + 1); i++) band += y[i] * light[i];
    sum += bands[l] * band;
  }
  return sum;
}

// Bands 0 and 1 that are stored apart, `low` = t_00, t_1-1, t_10, t_11, on a surface that is turned by `turn`, for column
// vectors: band 1 is the vector (-t_11, -t_1-1, t_10).
float4 prtTurnedLinear(float4 low, float3x3 turn) {
  float3 turned = mul(turn, float3(-low.w, -low.y, low.z));
  return float4(low.x, -turned.y, turned.z, -turned.x);
}

// The transpose of the inverse, times the determinant.
float3x3 prtCofactors(float3x3 m) {
  return float3x3(cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
}

// The rotation nearest to a matrix that blends those of bones: its polar factor, by Newton's iteration.
float3x3 prtNearestRotation(float3x3 m) {
  float3x3 q = m / pow(max(abs(determinant(m)), 1e-30), 1.0 / 3.0);
  [unroll] for (int i = 0; i < 6; i++) q = 0.5 * (q + prtCofactors(q) / determinant(q));
  return q;
}

// Compression in clusters, as D3DX: the mean of the cluster and each of its PCA vectors are put under the light once,
// on the CPU; what a receiver adds are its weights. `PRT_VECTORS` PCA vectors a cluster, defined before this text.
#ifdef PRT_VECTORS
float3 prtClustered(float3 meanUnderLight, float3 vectorsUnderLight[PRT_VECTORS], float weights[PRT_VECTORS]) {
  float3 sum = meanUnderLight;
  [unroll] for (int i = 0; i < PRT_VECTORS; i++) sum += weights[i] * vectorsUnderLight[i];
  return sum;
}
#endif

// Where the eye is, `toward` it, in the local frame of a receiver; an eye below the horizon is brought up to it.
float3 prtLocalView(float3 toward, float3 tangent, float3 normal) {
  float3 local = float3(dot(tangent, toward), dot(cross(normal, tangent), toward), max(dot(normal, toward), 0.0));
  float largest = max(max(abs(local.x), abs(local.y)), local.z);
  return largest > 1e-18 ? normalize(local / largest) : float3(0.0, 0.0, 1.0);
}

// The exit functions of a glossy layer at a local direction. `table`: slope, level and across, and `sectoral`, of the
// header of transfer.bin. PRT_ORDER is here that of the exit functions. Radiance is the specular colour times the sum
// over i of e[i] times row i of the matrix of the receiver under the light.
void prtExitFunctions(float3 v, float3 table[PRT_COUNT], float sectoral[PRT_ORDER], out float e[PRT_COUNT]) {
  e[0] = sectoral[0];
  [unroll] for (int l = 1; l < PRT_ORDER; l++) {
    int start = l * l;
    int last = (l - 1) * (l - 1);
    float cosine = e[start - 1];
    float sine = l > 1 ? e[last] : 0.0;
    e[start] = sectoral[l] * (v.x * sine + v.y * cosine);
    e[start + 2 * l] = sectoral[l] * (v.x * cosine - v.y * sine);
    [unroll] for (int i = 1; i < 2 * l; i++) {
      float risen = e[last + i - 1] * (table[start + i].x * v.z + table[start + i].y);
      if (i > 1 && i < 2 * l - 1) risen -= table[start + i].z * e[last - 2 * l + 3 + i - 2];
      e[start + i] = risen;
    }
  }
}
