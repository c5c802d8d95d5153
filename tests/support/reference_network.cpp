#include "tests/support/reference_network.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "firmware/nn/noise.h"

namespace lcdm::test {
namespace {

double silu(double x) { return x / (1 + std::exp(-x)); }
double elu(double x) { return x > 0 ? x : std::expm1(x); }
double relu(double x) { return std::max(x, 0.0); }

Planes mapped(Planes x, const std::function<double(double)>& f) {
  for (double& v : x.values) v = f(v);
  return x;
}

Planes sum(Planes a, const Planes& b) {
  for (std::size_t i = 0; i < a.values.size(); ++i) a.values[i] += b.values[i];
  return a;
}

Planes concat(const Planes& a, const Planes& b) {
  Planes out(a.channels + b.channels, a.height, a.width);
  std::copy(a.values.begin(), a.values.end(), out.values.begin());
  std::copy(b.values.begin(), b.values.end(),
            out.values.begin() + static_cast<std::ptrdiff_t>(a.values.size()));
  return out;
}

int mirrored(int i, int size) { return i < 0 ? -i : (i >= size ? 2 * size - 2 - i : i); }

// Value at (y, x) with padding outside.
double padded(const Planes& in, int c, int y, int x, bool reflect) {
  if (reflect) return in.at(c, mirrored(y, in.height), mirrored(x, in.width));
  const bool inside = y >= 0 && y < in.height && x >= 0 && x < in.width;
  return inside ? in.at(c, y, x) : 0.0;
}

// Bilinear, align_corners false, as PyTorch defines it.
Planes resized(const Planes& in, int height, int width) {
  Planes out(in.channels, height, width);
  const auto place = [](int i, int from, int to) {
    return std::max(0.0, (i + 0.5) * from / to - 0.5);
  };
  for (int c = 0; c < in.channels; ++c) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double fy = place(y, in.height, height);
        const double fx = place(x, in.width, width);
        const int y0 = static_cast<int>(fy);
        const int x0 = static_cast<int>(fx);
        const int y1 = std::min(y0 + 1, in.height - 1);
        const int x1 = std::min(x0 + 1, in.width - 1);
        const double top = in.at(c, y0, x0) * (1 - fx + x0) + in.at(c, y0, x1) * (fx - x0);
        const double low = in.at(c, y1, x0) * (1 - fx + x0) + in.at(c, y1, x1) * (fx - x0);
        out.at(c, y, x) = top * (1 - fy + y0) + low * (fy - y0);
      }
    }
  }
  return out;
}

Planes nearest2(const Planes& in) {
  Planes out(in.channels, in.height * 2, in.width * 2);
  for (int c = 0; c < in.channels; ++c) {
    for (int y = 0; y < out.height; ++y) {
      for (int x = 0; x < out.width; ++x) out.at(c, y, x) = in.at(c, y / 2, x / 2);
    }
  }
  return out;
}

class Reference {
 public:
  Reference(const ModelConfig& config, const std::vector<RandomTensor>& weights)
      : config_(config), paper_(config.preset == PresetKind::kPaper) {
    for (const RandomTensor& t : weights) weights_[t.name] = &t;
  }

  std::map<std::string, Planes> run(const Planes& input) {
    keep("input", input);
    const Planes condition = decoder(encoder(input));
    head(condition);
    return std::move(outputs_);
  }

 private:
  const RandomTensor& weight(const std::string& name) const { return *weights_.at(name); }
  double bias(const std::string& name, int i) const {
    const auto found = weights_.find(name);
    return found == weights_.end()
               ? 0.0
               : static_cast<double>(found->second->values[static_cast<std::size_t>(i)]);
  }
  const Planes& keep(const std::string& name, const Planes& x) { return outputs_[name] = x; }

  // Any kernel, stride, padding, and depthwise where the weight has one input channel.
  Planes conv(const std::string& weight_name, const std::string& bias_name, const Planes& in,
              int stride, bool reflect) const {
    const RandomTensor& w = weight(weight_name);
    const int k = w.shape.size() == 4 ? static_cast<int>(w.shape[2]) : 1;
    const int group = static_cast<int>(w.shape[1]);
    const bool depthwise = group == 1 && in.channels > 1;
    Planes out(static_cast<int>(w.shape[0]), in.height / stride, in.width / stride);
    for (int o = 0; o < out.channels; ++o) {
      for (int y = 0; y < out.height; ++y) {
        for (int x = 0; x < out.width; ++x) {
          double acc = bias(bias_name, o);
          for (int c = 0; c < group; ++c) {
            for (int t = 0; t < k * k; ++t) {
              const double v = padded(in, depthwise ? o : c, y * stride + t / k - k / 2,
                                      x * stride + t % k - k / 2, reflect);
              const int i = (o * group + c) * k * k + t;
              acc += v * static_cast<double>(w.values[static_cast<std::size_t>(i)]);
            }
          }
          out.at(o, y, x) = acc;
        }
      }
    }
    return out;
  }
  Planes conv(const std::string& name, const Planes& in, int stride = 1,
              bool reflect = false) const {
    return conv(name + ".weight", name + ".bias", in, stride, reflect);
  }
  Planes cba(const std::string& name, const Planes& in, int stride = 1) {
    return keep(name, mapped(conv(name, in, stride), silu));
  }

  // ---- encoder ----

  Planes mv2(const std::string& name, const Planes& x, int stride) {
    Planes y = cba(name + ".conv1_1x1", x);
    y = cba(name + ".conv2_kxk", y, stride);
    y = conv(name + ".conv3_1x1", y);
    if (stride == 1 && y.channels == x.channels) y = sum(y, x);
    return keep(name + ".conv3_1x1", y);
  }

  Planes layer_norm(const std::string& name, const Planes& x) {
    Planes out = x;
    for (int p = 0; p < x.height; ++p) {
      for (int n = 0; n < x.width; ++n) {
        double mean = 0;
        double variance = 0;
        for (int c = 0; c < x.channels; ++c) mean += x.at(c, p, n) / x.channels;
        for (int c = 0; c < x.channels; ++c) {
          variance += (x.at(c, p, n) - mean) * (x.at(c, p, n) - mean) / x.channels;
        }
        for (int c = 0; c < x.channels; ++c) {
          out.at(c, p, n) =
              (x.at(c, p, n) - mean) / std::sqrt(variance + 1e-5) * bias(name + ".weight", c) +
              bias(name + ".bias", c);
        }
      }
    }
    return keep(name, out);
  }

  Planes attention(const std::string& name, const Planes& qkv) {
    const int dim = qkv.channels / 3;
    const int head_dim = dim / 4;
    Planes out(dim, qkv.height, qkv.width);
    for (int p = 0; p < qkv.height; ++p) {
      for (int h = 0; h < 4; ++h) {
        for (int q = 0; q < qkv.width; ++q) attend(qkv, p, h * head_dim, head_dim, q, out);
      }
    }
    return keep(name, out);
  }
  static void attend(const Planes& qkv, int p, int first, int head_dim, int q, Planes& out) {
    const int dim = qkv.channels / 3;
    std::vector<double> scores(static_cast<std::size_t>(qkv.width));
    double total = 0;
    for (int k = 0; k < qkv.width; ++k) {
      double dot = 0;
      for (int c = 0; c < head_dim; ++c) {
        dot += qkv.at(first + c, p, q) * qkv.at(dim + first + c, p, k);
      }
      scores[static_cast<std::size_t>(k)] = std::exp(dot / std::sqrt(head_dim));
      total += scores[static_cast<std::size_t>(k)];
    }
    for (int c = 0; c < head_dim; ++c) {
      double mixed = 0;
      for (int k = 0; k < qkv.width; ++k) {
        mixed += scores[static_cast<std::size_t>(k)] / total * qkv.at(2 * dim + first + c, p, k);
      }
      out.at(first + c, p, q) = mixed;
    }
  }

  Planes transformer(const std::string& name, Planes x) {
    Planes y = layer_norm(name + ".norm1", x);
    y = keep(name + ".attn.qkv", conv(name + ".attn.qkv", y));
    y = attention(name + ".attn", y);
    x = keep(name + ".attn.proj", sum(conv(name + ".attn.proj", y), x));
    y = layer_norm(name + ".norm2", x);
    y = cba(name + ".mlp.fc1", y);
    return keep(name + ".mlp.fc2", sum(conv(name + ".mlp.fc2", y), x));
  }

  static Planes unfolded(const Planes& image) {
    const int columns = image.width / 2;
    Planes out(image.channels, 4, image.height / 2 * columns);
    for (int c = 0; c < image.channels; ++c) {
      for (int y = 0; y < image.height; ++y) {
        for (int x = 0; x < image.width; ++x) {
          out.at(c, y % 2 * 2 + x % 2, y / 2 * columns + x / 2) = image.at(c, y, x);
        }
      }
    }
    return out;
  }
  static Planes folded(const Planes& tokens, int height, int width) {
    Planes out(tokens.channels, height, width);
    for (int c = 0; c < tokens.channels; ++c) {
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
          out.at(c, y, x) = tokens.at(c, y % 2 * 2 + x % 2, y / 2 * (width / 2) + x / 2);
        }
      }
    }
    return out;
  }

  Planes mobilevit(const std::string& name, const Planes& x) {
    Planes y = cba(name + ".conv_kxk", x);
    y = keep(name + ".conv_1x1", conv(name + ".conv_1x1", y));
    const int even_height = y.height + y.height % 2;
    const int even_width = y.width + y.width % 2;
    const bool odd = even_height != y.height || even_width != y.width;
    if (odd) y = keep(name + ".resize_up", resized(y, even_height, even_width));
    y = keep(name + ".unfold", unfolded(y));
    for (int j = 0; weights_.count(block(name, j) + ".norm1.weight") != 0; ++j) {
      y = transformer(block(name, j), y);
    }
    y = layer_norm(name + ".norm", y);
    y = keep(name + ".fold", folded(y, even_height, even_width));
    if (odd) y = keep(name + ".resize_back", resized(y, x.height, x.width));
    y = cba(name + ".conv_proj", y);
    return cba(name + ".conv_fusion", concat(x, y));
  }
  static std::string block(const std::string& name, int j) {
    return name + ".transformer." + std::to_string(j);
  }

  std::array<Planes, 5> encoder(const Planes& input) {
    std::array<Planes, 5> taps;
    Planes x = cba("encoder.stem", input, 2);
    taps[0] = x = mv2("encoder.stages.0.0", x, 1);
    x = mv2("encoder.stages.1.0", x, 2);
    x = mv2("encoder.stages.1.1", x, 1);
    taps[1] = x = mv2("encoder.stages.1.2", x, 1);
    for (std::size_t i = 2; i < 5; ++i) {
      const std::string stage = "encoder.stages." + std::to_string(i);
      taps[i] = x = mobilevit(stage + ".1", mv2(stage + ".0", x, 2));
    }
    taps[4] = cba("encoder.final_conv", x);
    return taps;
  }

  // ---- decoder and head ----

  Planes conv_block(const std::string& name, const Planes& x) {
    return keep(name, mapped(conv(name, x, 1, paper_), elu));
  }

  Planes decoder(const std::array<Planes, 5>& taps) {
    Planes x = taps[4];
    for (std::size_t i = 5; i-- > 0;) {
      const std::string name = "decoder.upconv_" + std::to_string(i);
      x = conv_block(name + "_0", x);
      x = paper_ ? nearest2(x) : resized(x, x.height * 2, x.width * 2);
      if (i > 0) x = concat(x, taps[i - 1]);
      x = conv_block(name + "_1", x);
    }
    return conv_block("decoder.condition", x);
  }

  Planes group_norm(const Planes& x) const {
    Planes out = x;
    const int members = x.channels / 4;
    const std::size_t plane = x.values.size() / static_cast<std::size_t>(x.channels);
    for (int g = 0; g < 4; ++g) {
      double mean = 0;
      double variance = 0;
      const std::size_t begin = static_cast<std::size_t>(g * members) * plane;
      const std::size_t count = static_cast<std::size_t>(members) * plane;
      for (std::size_t i = begin; i < begin + count; ++i) mean += x.values[i];
      mean /= static_cast<double>(count);
      for (std::size_t i = begin; i < begin + count; ++i) {
        variance += (x.values[i] - mean) * (x.values[i] - mean);
      }
      variance /= static_cast<double>(count);
      for (std::size_t i = begin; i < begin + count; ++i) {
        const int c = static_cast<int>(i / plane);
        out.values[i] =
            (x.values[i] - mean) / std::sqrt(variance + 1e-5) * bias("head.norm.weight", c) +
            bias("head.norm.bias", c);
      }
    }
    return out;
  }

  void head(const Planes& condition) {
    Planes x(1, condition.height, condition.width);
    if (config_.start == StartKind::kNoise) {
      std::vector<float> noise(x.values.size());
      fill_gaussian(config_.seed, noise);
      std::copy(noise.begin(), noise.end(), x.values.begin());
    }
    keep("head.start", x);
    keep("head.conv1", conv("head.conv1.weight", "", condition, 1, false));
    const std::vector<double> abar = noise_schedule();
    for (std::size_t k = 0; k < config_.steps.size(); ++k) {
      const double a = abar[static_cast<std::size_t>(config_.steps[k])];
      const bool last = k + 1 == config_.steps.size();
      const double next = last ? 1 : abar[static_cast<std::size_t>(config_.steps[k + 1])];
      x = keep("head." + std::to_string(k),
               ddim(x, denoised(static_cast<int>(k), condition, x), a, next));
    }
    keep("depth", mapped(x, [&](double v) {
           const double logit = v * config_.variable_std + config_.variable_mean;
           return 1 / (0.01 + 9.99 / (1 + std::exp(-logit)));
         }));
  }

  Planes denoised(int k, const Planes& condition, const Planes& x) {
    const std::string step = "head.steps." + std::to_string(k);
    const std::string name = "head." + std::to_string(k);
    const Planes fused =
        sum(conv("head.embed.weight", step + ".embed.bias", x, 1, false), condition);
    Planes h = conv("head.conv1.weight", "", fused, 1, false);
    for (int c = 0; c < h.channels; ++c) {
      for (int y = 0; y < h.height; ++y) {
        for (int x2 = 0; x2 < h.width; ++x2) {
          h.at(c, y, x2) =
              h.at(c, y, x2) * bias(step + ".conv1.scale", c) + bias(step + ".conv1.bias", c);
        }
      }
    }
    if (paper_) {
      keep(name + ".conv1", h);
      h = keep(name + ".norm", mapped(group_norm(h), relu));
    } else {
      h = keep(name + ".conv1", mapped(h, relu));
    }
    return conv("head.conv2", h);
  }

  Planes ddim(const Planes& x, const Planes& out, double a, double next) const {
    Planes result = x;
    for (std::size_t i = 0; i < x.values.size(); ++i) {
      const double v = out.values[i];
      const double s = x.values[i];
      const double x0 = paper_ ? (s - std::sqrt(1 - a) * v) / std::sqrt(a)
                               : std::sqrt(a) * s - std::sqrt(1 - a) * v;
      const double e = paper_ ? v : std::sqrt(1 - a) * s + std::sqrt(a) * v;
      result.values[i] = std::sqrt(next) * x0 + std::sqrt(1 - next) * e;
    }
    return result;
  }

  std::vector<double> noise_schedule() const {
    std::vector<double> roots;
    double product = 1;
    for (int t = 0; t < 150; ++t) {
      product *= 1 - (1e-4 + (0.02 - 1e-4) * t / 149);
      roots.push_back(std::sqrt(product));
    }
    if (!paper_) {
      const double first = roots.front();
      const double last = roots.back();
      for (double& s : roots) s = (s - last) * first / (first - last);
    }
    for (double& s : roots) s *= s;
    return roots;
  }

  const ModelConfig& config_;
  bool paper_;
  std::map<std::string, const RandomTensor*> weights_;
  std::map<std::string, Planes> outputs_;
};

}  // namespace

std::map<std::string, Planes> run_reference(const ModelConfig& config,
                                            const std::vector<RandomTensor>& weights,
                                            std::span<const float> rgb, int width, int height) {
  Planes input(3, height, width);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) {
        const int i = (y * width + x) * 3 + c;
        input.at(c, y, x) = static_cast<double>(rgb[static_cast<std::size_t>(i)]);
      }
    }
  }
  return Reference(config, weights).run(input);
}

}  // namespace lcdm::test
