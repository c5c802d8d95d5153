#include "app/source.h"
namespace lcdm {
bool is_source_uri(const std::string& text) { return text == "scene:" || text.find(':') != std::string::npos; }
}
