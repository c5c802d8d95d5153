// An option whose value is one of a few names.
#pragma once

#include <CLI/CLI.hpp>
#include <map>
#include <set>
#include <string>

namespace lcdm::model {

// `target` becomes what its name stands for in `choices`. (CLI11's own transformer prints the
// values too, which are bytes that no terminal likes.)
template <typename Target, typename Value>
CLI::Option* add_choice(CLI::App& command, const char* option, Target& target,
                        const std::map<std::string, Value>& choices, const std::string& text) {
  std::set<std::string> names;
  for (const auto& [name, value] : choices) names.insert(name);
  return command
      .add_option_function<std::string>(
          option, [&target, choices](const std::string& name) { target = choices.at(name); }, text)
      ->check(CLI::IsMember(names));
}

}  // namespace lcdm::model
