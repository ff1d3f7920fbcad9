import js from "@eslint/js";
import globals from "globals";

export default [
  { ignores: ["**/vendor/**"] },
  js.configs.recommended,
  {
    languageOptions: { globals: globals.browser },
    linterOptions: { reportUnusedDisableDirectives: "error" },
    rules: {
      eqeqeq: "error",
      "no-var": "error",
      "prefer-const": "error",
      "no-implicit-globals": "error",
      "no-restricted-syntax": [
        "error",
        {
          // texts of a robot must never become HTML
          selector:
            "Identifier[name=/^(innerHTML|outerHTML|insertAdjacentHTML|dangerouslySetInnerHTML)$/]",
          message: "Use text nodes.",
        },
      ],
    },
  },
  { files: ["**/vendor.js", "**/*.config.js"], languageOptions: { globals: globals.node } },
];
